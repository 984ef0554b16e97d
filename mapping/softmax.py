"""Fit of a softmax classifier that is linear in sparse features: convex, full batch, quasi-Newton.

Knows features, targets and weights; knows nothing of points, kernels or what a class means.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import torch

from mapping.kernels import SparseFeatures
from mapping.preconditioner import SparseFactor


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
    objective = _Objective(features, targets, sample_weights, offset, l2)
    W = torch.zeros(len(features.transposed_offsets), len(offset), device=offset.device)
    logits = offset.expand(len(targets), -1).contiguous()
    loss, residual = objective.loss_and_residual(W, logits)
    gradient = coordinates.pull(objective.gradient(W, residual))
    losses = [loss]
    history: deque[tuple[torch.Tensor, torch.Tensor, float]] = deque(maxlen=config.memory)
    converged = False
    for _ in range(config.max_iterations):
        step_U = -_inverse_hessian_times(gradient, history)
        slope = float((gradient * step_U).sum())
        direction = coordinates.push(step_U)
        logits_direction = features.times(direction)
        length, trial_loss = 1.0, loss
        for _ in range(12):
            trial_W, trial_logits = W + length * direction, logits + length * logits_direction
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
        curvature = float((s * y).sum())
        if curvature > 0:
            history.append((s, y, curvature))
        W, logits, loss, gradient = trial_W, trial_logits, trial_loss, new_gradient
        losses.append(loss)
        if len(losses) > 3 and losses[-4] - loss < 3 * config.tolerance:
            converged = True
            break
    return W, FitReport(losses, len(losses) - 1, converged)


class _Objective:
    """The penalised cross-entropy and its gradient, split so that logits are computed once a step."""

    def __init__(
        self,
        features: SparseFeatures,
        targets: torch.Tensor,
        weights: torch.Tensor,
        offset: torch.Tensor,
        l2: float,
    ):
        self.features, self.weights, self.l2 = features, weights, l2
        if targets.ndim == 1:
            targets = torch.nn.functional.one_hot(targets, len(offset)).to(offset.dtype)
        self.weighted_targets = targets * weights[:, None]

    def loss_and_residual(self, W: torch.Tensor, logits: torch.Tensor) -> tuple[float, torch.Tensor]:
        # Without the row maximum float32 overflows past 88; the shift is rarely needed, so it is conditional.
        if float(logits.abs().max()) > 60.0:
            logits = logits - logits.amax(1, keepdim=True)
        p = logits.exp()
        total = p.sum(1)
        data = torch.dot(self.weights, total.log()) - torch.dot(
            self.weighted_targets.view(-1), logits.view(-1)
        )
        penalty = 0.5 * self.l2 * torch.dot(W.view(-1), W.view(-1))
        residual = p.mul_((self.weights / total)[:, None]).sub_(self.weighted_targets)
        return float(data + penalty), residual

    def gradient(self, W: torch.Tensor, residual: torch.Tensor) -> torch.Tensor:
        return self.features.transpose_times(residual).add_(W, alpha=self.l2)


def _inverse_hessian_times(
    gradient: torch.Tensor, history: deque[tuple[torch.Tensor, torch.Tensor, float]]
) -> torch.Tensor:
    """L-BFGS two-loop recursion (Nocedal and Wright, algorithm 7.4)."""
    q = gradient.clone()
    alphas = []
    for s, y, curvature in reversed(history):
        alpha = float((s * q).sum()) / curvature
        q.sub_(y, alpha=alpha)
        alphas.append(alpha)
    if history:
        _, y, curvature = history[-1]
        q.mul_(curvature / float(y.square().sum()))
    for (s, y, curvature), alpha in zip(history, reversed(alphas)):
        q.add_(s, alpha=alpha - float((y * q).sum()) / curvature)
    return q
