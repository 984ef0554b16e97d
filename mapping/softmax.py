"""Fit of a softmax classifier that is linear in sparse features: convex, full batch, quasi-Newton.

Knows features, targets and weights; knows nothing of points, kernels or what a class means.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import torch

from mapping.preconditioner import SparseFactor
from mapping.sparse_features import SparseFeatures, SparseRows
from mapping.threads import Threads


@dataclass(frozen=True)
class FitConfig:
    """How the convex loss is minimised."""

    max_iterations: int = 200
    """Upper limit of quasi-Newton steps."""
    tolerance: float = 1e-4
    """Stop when the mean loss [nats] fell by less than this a step, on average over the last 3 steps."""
    memory: int = 8
    """Pairs of steps that L-BFGS remembers."""


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
    coordinates: SparseFactor,
    l2: float,
    config: FitConfig,
) -> tuple[torch.Tensor, FitReport]:
    """Minimise sum_i w_i CE(softmax(W^T phi_i + offset), t_i) + l2/2 ||W||^2.

    targets: (N,) int64 classes or (N, C) float32 distributions, rows as in `features`.
    sample_weights: (N,) that sum to 1; offset: (C,) fixed. Returns W (H, C) and the report.

    Neighbouring kernels overlap, so the loss is badly conditioned in W. The fit runs in coordinates U with
    W = G^T U, where G whitens a bound on the Hessian (Böhning 1992): there L-BFGS needs a third of the
    steps. Logits are linear in W, so trying a step length costs an exponential a sample and no product.
    """
    with Threads(offset.device) as threads:
        objective = _Objective(features, targets, sample_weights, l2, len(offset), threads)
        return _minimise(objective, offset, coordinates, config)


def _minimise(
    objective: _Objective, offset: torch.Tensor, coordinates: SparseFactor, config: FitConfig
) -> tuple[torch.Tensor, FitReport]:
    """L-BFGS from W = 0 with a backtracking line search (Nocedal and Wright, chapters 3 and 7)."""
    W = torch.zeros(objective.shape, device=offset.device)
    logits = offset.expand(objective.samples, -1).contiguous()
    loss, residual = objective.loss_and_residual(W, logits)
    gradient = coordinates.pull(objective.gradient(W, residual))
    losses = [loss]
    history: deque[tuple[torch.Tensor, torch.Tensor, float]] = deque(maxlen=config.memory)
    converged = False
    for _ in range(config.max_iterations):
        step_U = -_inverse_hessian_times(gradient, history)
        slope = _dot(gradient, step_U)
        direction = coordinates.push(step_U)
        logits_direction = objective.logits_of(direction)
        length, trial_loss = 1.0, loss
        for _ in range(12):
            trial_W = torch.add(W, direction, alpha=length)
            trial_logits = torch.add(logits, logits_direction, alpha=length)
            trial_loss, residual = objective.loss_and_residual(trial_W, trial_logits)
            if trial_loss <= loss + 1e-4 * length * slope:
                break
            # Minimum of the parabola through both losses and the slope, kept within 0.1-0.6 of the length.
            parabola = -slope * length / (2 * (trial_loss - loss - slope * length))
            length *= min(max(parabola, 0.1), 0.6)
        else:
            converged = True  # no descent is left at this precision
            break
        new_gradient = coordinates.pull(objective.gradient(trial_W, residual))
        s, y = length * step_U, new_gradient - gradient
        curvature = _dot(s, y)
        if curvature > 0:
            history.append((s, y, curvature))
        W, logits, loss, gradient = trial_W, trial_logits, trial_loss, new_gradient
        losses.append(loss)
        if len(losses) > 3 and losses[-4] - loss < 3 * config.tolerance:
            converged = True
            break
    return W, FitReport(losses, len(losses) - 1, converged)


class _Objective:
    """The penalised cross-entropy and its gradient, each thread having its share of samples or hinge points.

    Split so that logits are computed once a step.
    """

    def __init__(
        self,
        features: SparseFeatures,
        targets: torch.Tensor,
        weights: torch.Tensor,
        l2: float,
        classes: int,
        threads: Threads,
    ):
        if targets.ndim == 1:
            targets = torch.nn.functional.one_hot(targets, classes).float()
        self.samples = len(weights)
        self.shape = len(features.transposed.offsets), classes
        self.weights, self.l2, self.threads = weights, l2, threads
        self.weighted_targets = targets * weights[:, None]
        self.rows = features.rows.split(threads.count)
        self.columns = features.transposed.split(threads.count)
        self.shares = threads.split(self.samples)

    def logits_of(self, W: torch.Tensor) -> torch.Tensor:
        """Phi W: (H, C) -> (N, C)."""
        return self._joined(self.rows, W)

    def loss_and_residual(self, W: torch.Tensor, logits: torch.Tensor) -> tuple[float, torch.Tensor]:
        """The objective and its derivative by the logits (N, C)."""
        residual = torch.empty_like(logits)

        def cross_entropy(rows: slice) -> float:
            part, weights, targets = logits[rows], self.weights[rows], self.weighted_targets[rows]
            # Without the row maximum float32 overflows past 88; it is rarely needed, so it is conditional.
            low, high = torch.aminmax(part)
            if max(-float(low), float(high)) > 60.0:
                part = part - part.amax(1, keepdim=True)
            p = torch.exp(part, out=residual[rows])
            total = p @ p.new_ones(p.shape[1])  # twice as fast as a sum over short rows
            loss = torch.dot(weights, total.log()) - torch.dot(targets.view(-1), part.view(-1))
            p.mul_((weights / total)[:, None]).sub_(targets)
            return float(loss)

        penalty = 0.5 * self.l2 * _dot(W, W)
        return sum(self.threads.map(cross_entropy, self.shares)) + penalty, residual

    def gradient(self, W: torch.Tensor, residual: torch.Tensor) -> torch.Tensor:
        """The objective's derivative by W (H, C)."""
        return self._joined(self.columns, residual).add_(W, alpha=self.l2)

    def _joined(self, parts: list[SparseRows], table: torch.Tensor) -> torch.Tensor:
        """The products of consecutive parts with a table, each thread writing its own."""
        out = table.new_empty(sum(len(part.offsets) for part in parts), table.shape[1])
        pieces = zip(parts, out.split([len(part.offsets) for part in parts]))
        self.threads.map(lambda piece: piece[1].copy_(piece[0].times(table)), pieces)
        return out


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
