"""Fit of a softmax classifier that is linear in sparse features: convex, full batch, quasi-Newton.

Knows features, targets and weights; knows nothing of points, kernels or what a class means.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace

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
    sample_weights: (N,) that sum to 1; offset: (C,) fixed; whiten: a factor for a Hessian, from its diagonal:
    (H,), a bound for every class, or (H, C) of each class, where config.renew asks for it. start: (H, C)
    where the fit begins, W = 0 by default. Returns W (H, C) and the report.

    Neighbouring kernels overlap, so the loss is badly conditioned in W. Steps are whitened by a bound on the
    Hessian (Böhning 1992): L-BFGS needs a third of the steps. Where classes are sure the bound is far too
    large; the curvature found on the way halves the steps again.
    """
    with Threads(offset.device) as threads:
        objective = objective_of(features, targets, sample_weights, offset, l2, threads)
        W = torch.zeros(objective.shape, device=offset.device) if start is None else start
        if start is not None:
            config = replace(config, tolerance=config.warm * config.tolerance)
        known = start is not None and config.renew > 0
        factor = whiten(objective.curvature_at(W) if known else objective.curvature())
        return minimise(objective, factor, whiten, config, W)


def minimise(
    objective: Objective,
    factor: SparseFactor,
    whiten: Callable[[torch.Tensor], SparseFactor],
    config: FitConfig,
    W: torch.Tensor,
) -> tuple[torch.Tensor, FitReport]:
    """L-BFGS from W with a backtracking line search (Nocedal and Wright, chapters 3 and 7)."""
    loss, gradient = objective.at(W)
    losses = [loss]
    history: deque[tuple[torch.Tensor, torch.Tensor, float]] = deque(maxlen=config.memory)
    converged, renewed_at = False, config.renew
    for _ in range(config.max_iterations):
        if config.renew and len(losses) > renewed_at:
            factor, renewed_at = whiten(objective.curvature_at(W)), 2 * renewed_at
        direction = _inverse_hessian_times(gradient, history, factor).neg_()
        slope = _dot(gradient, direction)
        length = 1.0 if history else FIRST_STEP
        for _ in range(12):
            trial_W = torch.add(W, direction, alpha=length)
            trial_loss, trial_gradient = objective.at(trial_W)
            if trial_loss <= loss + 1e-4 * length * slope:
                break
            # Minimum of the parabola through both losses and the slope, kept within 0.1-0.6 of the length.
            parabola = -slope * length / (2 * (trial_loss - loss - slope * length))
            length *= min(max(parabola, 0.1), 0.6)
        else:
            converged = True  # no descent is left at this precision
            break
        s, y = direction.mul_(length), trial_gradient - gradient
        curvature = _dot(s, y)
        if curvature > 0:
            history.append((s, y, curvature))
        W, loss, gradient = trial_W, trial_loss, trial_gradient
        losses.append(loss)
        if len(losses) > 3 and losses[-4] - loss < 3 * config.tolerance:
            converged = True
            break
    return W, FitReport(losses, len(losses) - 1, converged)


def _inverse_hessian_times(
    gradient: torch.Tensor,
    history: deque[tuple[torch.Tensor, torch.Tensor, float]],
    factor: SparseFactor,
) -> torch.Tensor:
    """L-BFGS two-loop recursion (Nocedal and Wright, algorithm 7.4) from the whitened Hessian on."""
    q = gradient.clone()
    alphas = []
    for s, y, curvature in reversed(history):
        alpha = _dot(s, q) / curvature
        q.sub_(y, alpha=alpha)
        alphas.append(alpha)
    q = factor.push(factor.pull(q))
    if history:
        _, y, curvature = history[-1]
        white = factor.pull(y)
        q.mul_(curvature / _dot(white, white))
    for (s, y, curvature), alpha in zip(history, reversed(alphas)):
        q.add_(s, alpha=alpha - _dot(y, q) / curvature)
    return q


def _dot(a: torch.Tensor, b: torch.Tensor) -> float:
    return float(torch.dot(a.view(-1), b.view(-1)))
