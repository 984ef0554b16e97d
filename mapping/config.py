"""Settings of the map: how features are made and how the loss is minimised.

Knows the names and ranges of settings; knows nothing of how they act. Imports neither numpy nor torch.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar, Literal

from mapping.settings import Checked, Count, CountOrNone, Length, NotNegative, OpenShare, Positive

FIT_CUTOFF = 3e-3
"""Features below this are dropped while fitting, where nothing else is said."""


@dataclass(frozen=True)
class FitConfig(Checked):
    """How the convex loss is minimised."""

    SECTION: ClassVar[str] = "map.fit"

    max_iterations: Count = 200
    """Upper limit of quasi-Newton steps."""
    tolerance: NotNegative = 1e-4
    """Stop when the mean loss [nats] fell by less than this a step, on average over the last 3 steps."""
    memory: Count = 8
    """Pairs of steps that L-BFGS remembers."""
    renew: CountOrNone = 0
    """The curvature of each class is worked out after so many steps, and each time these have doubled: where
    classes are sure half the steps, for fits that take longer than some milliseconds. 0: never."""
    warm: Positive = 1.0
    """Where earlier weights are given to begin with, stop at so many times the tolerance: what is left was
    left there before, but near what is new."""


@dataclass(frozen=True)
class ModelConfig(Checked):
    """The model on given hinge points: its penalty, and what it answers where nothing was seen."""

    SECTION: ClassVar[str] = "map"

    l2: NotNegative = 1e-6
    """Weight of the squared norm of W beside the mean cross-entropy."""
    far_uncertainty: OpenShare | None = 0.95
    """p(uncertain) out of reach of every hinge point; None gives every class the same share there."""
    empty_log_odds: float | None = None
    """Log odds of class 0 against the other known classes where the kernels vanish; None: all equal."""
    fit_cutoff: OpenShare = FIT_CUTOFF
    """Features below this are dropped while fitting; predictions keep all that matter."""
    fit: FitConfig = field(default_factory=FitConfig)
    """How the loss is minimised."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """cpu, cuda, or auto (the CPU: on a map of this size a graphics card has not been shown to be faster)."""


@dataclass(frozen=True)
class MapConfig(ModelConfig):
    """The model with hinge points of its own: a grid around the data, all of one width."""

    gamma: Positive = 1000.0
    """Kernel width: phi = exp(-gamma d^2), in 1/m^2 for points in metres."""
    hinge_spacing: Length = 0.05
    """Spacing of the default hinge grid [m], used when fit() is given no hinge points."""
