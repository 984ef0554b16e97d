"""Fit of a softmax classifier that is linear in sparse features: convex, full batch, quasi-Newton.

Knows features, targets and weights; knows nothing of points, kernels or what a class means.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from math import isfinite

import torch

from mapping.config import FitConfig
from mapping.preconditioner import SparseFactor
from mapping.sparse_features import SparseFeatures
from mapping.sparse_rows import SparseRows
from mapping.threads import Threads

FIRST_STEP = 0.2
"""Length of the first step tried: before anything is known of the curvature, the whole one overshoots by as
many times as kernels overlap."""

ROW_COST = 8
"""What a sample's share in the loss takes of the time, in features of its row: far from objects rows are
short, and threads that had as many features each would not end at once."""
SHARED_FROM = 4096
"""Samples from which on threads share them."""


@dataclass(frozen=True)
class FitReport:
    """What the fit did. losses: the objective after every step, the start first."""

    losses: list[float] = field(default_factory=list)
    iterations: int = 0
    converged: bool = False


def fit_softmax(
    features: SparseFeatures,
    targets: torch.Tensor,
    sample_weights: torch.Tensor,
    offset: torch.Tensor,
    whiten: Callable[[torch.Tensor], SparseFactor],
    l2: float,
    config: FitConfig,
    start: torch.Tensor | None = None,
) -> tuple[torch.Tensor, FitReport]:
    """Minimise sum_i w_i CE(softmax(W^T phi_i + offset), t_i) + l2/2 ||W||^2.

    targets: (N,) int64 classes or (N, C) float32 distributions, rows as in `features`.
    sample_weights: (N,) that sum to 1; offset: (C,) fixed; whiten: from the diagonal (H,) of a bound on each
    class's Hessian, a factor for that bound. start: (H, C) where the fit begins, W = 0 by default. Returns W
    (H, C) and the report.

    Neighbouring kernels overlap, so the loss is badly conditioned in W. The fit runs in coordinates U with
    W = G^T U, where G whitens a bound on the Hessian (Böhning 1992): there L-BFGS needs a third of the
    steps. Logits are linear in W, so another length along one direction needs no new logits' product.
    """
    with Threads(offset.device) as threads:
        objective = _Objective(features, targets, sample_weights, offset, l2, threads)
        coordinates = whiten(objective.curvature())
        return _minimise(objective, coordinates, config, start)


def _minimise(
    objective: _Objective, coordinates: SparseFactor, config: FitConfig, start: torch.Tensor | None
) -> tuple[torch.Tensor, FitReport]:
    """L-BFGS from a start with a backtracking line search (Nocedal and Wright, chapters 3 and 7)."""
    W = objective.start() if start is None else objective.start_at(start)
    loss, slopes = objective.at(W, 0.0)
    gradient = coordinates.pull(slopes)
    losses = [loss]
    history: deque[tuple[torch.Tensor, torch.Tensor, float]] = deque(maxlen=config.memory)
    converged = False
    for _ in range(config.max_iterations):
        step_U = _inverse_hessian_times(gradient, history).neg_()
        slope = _dot(gradient, step_U)
        direction = coordinates.push(step_U)
        length = 1.0 if history else FIRST_STEP
        for trial in range(12):
            trial_W = torch.add(W, direction, alpha=length)
            trial_loss, slopes = objective.at(trial_W, length, direction if trial == 0 else None)
            if trial_loss <= loss + 1e-4 * length * slope:
                break
            # Minimum of the parabola through both losses and the slope, kept within 0.1-0.6 of the length.
            parabola = -slope * length / (2 * (trial_loss - loss - slope * length))
            length *= min(max(parabola, 0.1), 0.6)
        else:
            converged = True  # no descent is left at this precision
            break
        objective.accept()
        new_gradient = coordinates.pull(slopes)
        s, y = step_U.mul_(length), new_gradient - gradient
        curvature = _dot(s, y)
        if curvature > 0:
            history.append((s, y, curvature))
        W, loss, gradient = trial_W, trial_loss, new_gradient
        losses.append(loss)
        if len(losses) > 3 and losses[-4] - loss < 3 * config.tolerance:
            converged = True
            break
    return W, FitReport(losses, len(losses) - 1, converged)


class _Objective:
    """The penalised cross-entropy and its gradient, from a few shares of the samples, at least one a thread.

    Logits are linear in W: each share keeps its own and those of the direction searched along.
    """

    def __init__(
        self,
        features: SparseFeatures,
        targets: torch.Tensor,
        weights: torch.Tensor,
        offset: torch.Tensor,
        l2: float,
        threads: Threads,
    ):
        if targets.ndim == 1:
            targets = torch.nn.functional.one_hot(targets, len(offset)).float()
        targets = targets * weights[:, None]
        self.shape = features.hinge_count, len(offset)
        self.l2, self.threads = l2, threads
        # Few samples are one share for any number of threads: handing them over costs more than it wins.
        count = threads.pieces if len(features.rows.offsets) >= SHARED_FROM else 1
        parts = features.rows.split(count, ROW_COST)
        sizes = [len(part.offsets) for part in parts]
        pieces = zip(parts, weights.split(sizes), targets.split(sizes))
        self.shares = threads.map(lambda piece: _Share(*piece, offset, self.shape[0]), pieces)

    def start(self) -> torch.Tensor:
        """W = 0, where the logits are the offset."""
        return self.shares[0].logits.new_zeros(self.shape)

    def start_at(self, W: torch.Tensor) -> torch.Tensor:
        """W (H, C), the logits being its own."""

        def set_logits(share: _Share) -> None:
            share.logits += share.rows.times(W)

        self.threads.map(set_logits, self.shares)
        return W.clone()

    def curvature(self) -> torch.Tensor:
        """The diagonal (H,) of a bound on the Hessian: p (1 - p) is at most 1/4 for every class."""
        squares = self.threads.map(
            lambda share: share.columns.squared().times(share.weights[:, None]), self.shares
        )
        return 0.25 * torch.stack(squares).sum(0)[:, 0] + self.l2

    def at(
        self, W: torch.Tensor, length: float, direction: torch.Tensor | None = None
    ) -> tuple[float, torch.Tensor]:
        """The objective at W and its derivative (H, C), W being `length` times the direction (H, C) away from
        the last accepted place; None: the direction is the one asked for before."""

        # Few pieces of work: handing it over costs as much as a product with few samples.
        def part(share: _Share) -> tuple[float, torch.Tensor]:
            if direction is not None:
                share.along = share.rows.times(direction)
            loss, residual = share.loss_and_residual(length)
            return loss, share.columns.times(residual)

        losses, gradients = zip(*self.threads.map(part, self.shares))
        gradient = torch.add(gradients[0], W, alpha=self.l2)
        for other in gradients[1:]:
            gradient.add_(other)
        return sum(losses) + 0.5 * self.l2 * _dot(W, W), gradient

    def accept(self) -> None:
        """The place asked about last is where the next direction starts."""
        for share in self.shares:
            share.logits, share.trial = share.trial, share.logits


class _Share:
    """Some samples, and the logits they have where the fit stands."""

    def __init__(
        self,
        rows: SparseRows,
        weights: torch.Tensor,
        weighted_targets: torch.Tensor,
        offset: torch.Tensor,
        hinge_count: int,
    ):
        self.rows, self.columns = rows, rows.transposed(hinge_count)
        self.weights, self.minus_targets = weights, -weighted_targets
        self.logits = offset.repeat(len(weights), 1)
        self.along = torch.zeros_like(self.logits)
        self.trial, self.residual = torch.empty_like(self.logits), torch.empty_like(self.logits)

    def loss_and_residual(self, length: float) -> tuple[float, torch.Tensor]:
        """The cross-entropy `length` along the direction and its derivative by the logits (n, C)."""
        torch.add(self.logits, self.along, alpha=length, out=self.trial)
        loss, scale = self._exponentials(self.trial)
        if not isfinite(loss):
            # Beyond 88 float32 overflows; rare, so the rows' maxima are only taken when it happens.
            self.trial.sub_(self.trial.amax(1, keepdim=True))
            loss, scale = self._exponentials(self.trial)
        return loss, torch.addcmul(self.minus_targets, self.residual, scale[:, None], out=self.residual)

    def _exponentials(self, logits: torch.Tensor) -> tuple[float, torch.Tensor]:
        """Fills `residual` with exponentials; the loss, and the factor (n,) that turns them into weighted
        probabilities."""
        p = torch.exp(logits, out=self.residual)
        total = p @ p.new_ones(p.shape[1])  # twice as fast as a sum over short rows
        loss = torch.dot(self.weights, total.log())
        loss += torch.dot(self.minus_targets.view(-1), logits.view(-1))
        return float(loss), self.weights / total


def _inverse_hessian_times(
    gradient: torch.Tensor, history: deque[tuple[torch.Tensor, torch.Tensor, float]]
) -> torch.Tensor:
    """L-BFGS two-loop recursion (Nocedal and Wright, algorithm 7.4)."""
    q = gradient.clone()
    alphas = []
    for s, y, curvature in reversed(history):
        alpha = _dot(s, q) / curvature
        q.sub_(y, alpha=alpha)
        alphas.append(alpha)
    if history:
        _, y, curvature = history[-1]
        q.mul_(curvature / _dot(y, y))
    for (s, y, curvature), alpha in zip(history, reversed(alphas)):
        q.add_(s, alpha=alpha - _dot(y, q) / curvature)
    return q


def _dot(a: torch.Tensor, b: torch.Tensor) -> float:
    return float(torch.dot(a.view(-1), b.view(-1)))
