"""A convex fit in a fixed number of steps, of which each weight's depend on what is near it alone.

Knows an objective with a bound on each weight's curvature; must not know features or classes.

What a quasi-Newton fit does at a place depends on all data by way of a few numbers: lengths of steps, how
much of earlier ones is kept, when to stop. Here nothing is shared: a part of the data fitted alone has the
whole's weights, but for what its missing neighbours say, which fades within a few kernels' reach, converged
or not.
"""

from __future__ import annotations

import torch

from mapping.objectives import Bounded
from mapping.softmax import FitReport

RENEWED = 4
"""The bound is worked out before the first step, after so many, and each time their number has doubled."""


def fit_locally(objective: Bounded, steps: int, start: torch.Tensor | None) -> tuple[torch.Tensor, FitReport]:
    """Weights (H, C) after accelerated steps (Nesterov 1983) from `start`, 0 by default; and the report."""
    W = torch.zeros(objective.shape) if start is None else start.clone()
    ahead, bound, losses = W.clone(), objective.bound_at(W), []
    renewed = RENEWED
    for step in range(1, steps + 1):
        if step > renewed:
            bound, renewed = objective.bound_at(W), 2 * renewed
        loss, slope = objective.at(ahead)
        losses.append(loss)
        ahead.sub_(slope.div_(bound))
        # W becomes the place from which the next step is taken, and what was ahead the weights.
        W.lerp_(ahead, 1 + (step - 1) / (step + 2))
        W, ahead = ahead, W
    return W, FitReport(losses, steps, False)
