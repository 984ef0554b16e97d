"""Fit of a softmax classifier that is linear in sparse features: convex, full batch, quasi-Newton.

Knows features, targets and weights; knows nothing of points, kernels or what a class means.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import torch

from mapping.config import FitConfig
from mapping.objectives import Objective, objective_of
from mapping.preconditioner import SparseFactor
from mapping.sparse_features import SparseFeatures
from mapping.threads import Threads
from mapping.tiled_features import TiledFeatures

FIRST_STEP = 0.2
"""Length of the first step tried: before anything is known of the curvature, the whole one overshoots by as
many times as kernels overlap."""


@dataclass(frozen=True)
class FitReport:
    """What the fit did. losses: the objective after every step, the start first."""

    losses: list[float] = field(default_factory=list)
    iterations: int = 0
    converged: bool = False


def fit_softmax(
    features: TiledFeatures | SparseFeatures,
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
    steps.
    """
    with Threads(offset.device) as threads:
        objective = objective_of(features, targets, sample_weights, offset, l2, threads)
        W = torch.zeros(objective.shape, device=offset.device) if start is None else start
        return _minimise(objective, whiten(objective.curvature()), config, W)


def _minimise(
    objective: Objective, coordinates: SparseFactor, config: FitConfig, W: torch.Tensor
) -> tuple[torch.Tensor, FitReport]:
    """L-BFGS from W with a backtracking line search (Nocedal and Wright, chapters 3 and 7)."""
    loss, slopes = objective.at(W)
    gradient = coordinates.pull(slopes)
    losses = [loss]
    history: deque[tuple[torch.Tensor, torch.Tensor, float]] = deque(maxlen=config.memory)
    converged = False
    for _ in range(config.max_iterations):
        step_U = _inverse_hessian_times(gradient, history).neg_()
        slope = _dot(gradient, step_U)
        direction = coordinates.push(step_U)
        length = 1.0 if history else FIRST_STEP
        for _ in range(12):
            trial_W = torch.add(W, direction, alpha=length)
            trial_loss, slopes = objective.at(trial_W)
            if trial_loss <= loss + 1e-4 * length * slope:
                break
            # Minimum of the parabola through both losses and the slope, kept within 0.1-0.6 of the length.
            parabola = -slope * length / (2 * (trial_loss - loss - slope * length))
            length *= min(max(parabola, 0.1), 0.6)
        else:
            converged = True  # no descent is left at this precision
            break
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
