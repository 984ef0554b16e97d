"""Fit of a softmax classifier that is linear in sparse features: convex, full batch, quasi-Newton.

Knows features, targets and weights; knows nothing of points, kernels or what a class means.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import torch

from mapping.kernels import SparseFeatures


@dataclass(frozen=True)
class FitConfig:
    """How the convex loss is minimised."""

    max_iterations: int = 200
    """Upper limit of quasi-Newton steps."""
    tolerance: float = 2e-5
    """Stop when the loss fell by less than this, relative to the loss, on average over the last 5 steps."""
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
    hinge_count: int,
    l2: float,
    config: FitConfig,
) -> tuple[torch.Tensor, FitReport]:
    """Minimise sum_i w_i CE(softmax(W^T phi_i + offset), t_i) / sum_i w_i + l2/2 ||W||^2.

    targets: (N,) int64 classes or (N, C) float32 distributions, rows as in `features`.
    offset: (C,) fixed. Returns W (H, C) and the report.

    Logits are linear in W, so one product gives them along a whole search direction and a step length
    costs only an exponential a sample; each step needs two sparse products in all.
    """
    objective = _Objective(features, targets, sample_weights / sample_weights.sum(), offset, l2)
    W = torch.zeros(hinge_count, len(offset), device=offset.device)
    logits = offset.expand(len(targets), -1).contiguous()
    # The softmax Hessian is at most 1/2 per feature; the diagonal scales rare hinges up.
    scale = 1.0 / (0.25 * features.squared_column_sums(objective.weights) + l2)[:, None]
    loss, residual = objective.loss_and_residual(W, logits)
    gradient = objective.gradient(W, residual)
    losses = [loss]
    history: deque[tuple[torch.Tensor, torch.Tensor, float]] = deque(maxlen=config.memory)
    converged = False
    for _ in range(config.max_iterations):
        direction = -_inverse_hessian_times(gradient, history, scale)
        slope = float((gradient * direction).sum())
        if slope >= 0:  # rounding broke the curvature estimate: start it anew
            history.clear()
            direction = -scale * gradient
            slope = float((gradient * direction).sum())
        logits_direction = features.times(direction)
        step, trial_loss = 1.0, loss
        for _ in range(12):
            trial_W, trial_logits = W + step * direction, logits + step * logits_direction
            trial_loss, residual = objective.loss_and_residual(trial_W, trial_logits)
            if trial_loss <= loss + 1e-4 * step * slope:
                break
            # Minimum of the parabola through both losses and the slope, kept inside (0.1, 0.6) of the step.
            parabola = -slope * step / (2 * (trial_loss - loss - slope * step)) if trial_loss < 1e30 else 0.1
            step *= min(max(parabola, 0.1), 0.6)
        else:
            converged = True  # no descent left at this precision
            break
        new_gradient = objective.gradient(trial_W, residual)
        s, y = trial_W - W, new_gradient - gradient
        curvature = float((s * y).sum())
        if curvature > 1e-12:
            history.append((s, y, curvature))
        W, logits, loss, gradient = trial_W, trial_logits, trial_loss, new_gradient
        losses.append(loss)
        if len(losses) > 5 and losses[-6] - loss < 5 * config.tolerance * loss:
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
            self.targets = torch.nn.functional.one_hot(targets, len(offset)).to(offset.dtype)
        else:
            self.targets = targets

    def loss_and_residual(self, W: torch.Tensor, logits: torch.Tensor) -> tuple[float, torch.Tensor]:
        # Without the row maximum float32 overflows past 88; the shift is rarely needed, so it is conditional.
        if float(logits.abs().max()) > 60.0:
            logits = logits - logits.amax(1, keepdim=True)
        p = logits.exp()
        total = p.sum(1)
        log_likelihood = (self.targets * logits).sum(1) - total.log()
        data = -float(torch.dot(self.weights, log_likelihood).double())
        penalty = 0.5 * self.l2 * float(W.square().sum())
        residual = p.mul_((self.weights / total)[:, None]).sub_(self.targets * self.weights[:, None])
        return data + penalty, residual

    def gradient(self, W: torch.Tensor, residual: torch.Tensor) -> torch.Tensor:
        return self.features.transpose_times(residual).add_(W, alpha=self.l2)


def _inverse_hessian_times(
    gradient: torch.Tensor, history: deque[tuple[torch.Tensor, torch.Tensor, float]], scale: torch.Tensor
) -> torch.Tensor:
    """L-BFGS two-loop recursion with a diagonal start (Nocedal and Wright, algorithm 7.4)."""
    q = gradient.clone()
    alphas = []
    for s, y, curvature in reversed(history):
        alpha = float((s * q).sum()) / curvature
        q.sub_(y, alpha=alpha)
        alphas.append(alpha)
    q.mul_(scale)
    if history:
        _, y, curvature = history[-1]
        q.mul_(curvature / float((y * y * scale).sum()))
    for (s, y, curvature), alpha in zip(history, reversed(alphas)):
        q.add_(s, alpha=alpha - float((y * q).sum()) / curvature)
    return q
