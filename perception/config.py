"""Settings of perception: one dataclass whose field texts are also the command line's help."""

from __future__ import annotations

from dataclasses import dataclass, fields
from math import isfinite

from mapping.errors import ConfigError


@dataclass(frozen=True)
class PerceptionConfig:
    """How a frame is cleaned and what counts as free, surface and occluded. Lengths in metres."""

    minimum_pixels: int = 30
    """An object with fewer valid pixels than this is skipped and listed."""
    depth_noise: float = 0.0025
    """Standard deviation of measured depth at 1 m [m]; it grows with the square of the depth."""
    grazing_angle: float = 82.0
    """Depth steps steeper than a surface seen at this angle to its normal [degrees] are jumps."""
    remove_flying_pixels: bool = True
    """Remove pixels that hang between a near and a far surface."""
    use_plane: bool = True
    """Look for the support plane; without it the table frame is the camera frame."""
    plane_threshold: float = 0.01
    """Distance of a point to the support plane that still counts as on it [m]."""
    plane_points: int = 1500
    """Points that the plane search looks at."""
    plane_iterations: int = 150
    """RANSAC iterations for each candidate plane."""
    plane_candidates: int = 4
    """Planes tried before the best one below the objects is taken."""
    plane_reach: float = 0.25
    """The plane is looked for within this distance of the objects first [m]."""
    plane_minimum_share: float = 0.08
    """A plane with a smaller share of the points near the objects is not convincing."""
    table_margin: float = 0.003
    """Labelled points nearer to the support plane than this are label bleed onto the table [m]."""
    flat_height: float = 0.008
    """An object no higher than this is flat: only points at or under the plane are taken from it [m]."""
    cluster_gap: float = 0.012
    """Pieces of one object nearer to each other than about this are one cluster [m]."""
    split_gap: float = 0.15
    """Pieces parted by something in front of them belong together up to this gap [m]."""
    segment_height: float = 0.012
    """Without labels, what stands higher than this above the support plane is an object [m]."""
    segment_reach: float = 0.35
    """Without labels, only what lies within this height above a plane speaks for it as the support [m]."""
    segment_float: float = 0.25
    """Without labels, a piece that begins higher than this above the support does not stand on it [m]."""
    segment_minimum_area: float = 4e-4
    """Without labels, a piece with less visible surface than this is no object [m^2]."""
    surface_margin: float = 0.004
    """Points within this depth of a measured surface lie on it, more at long range [m]."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, bool):
                continue
            if not (isinstance(value, (int, float)) and isfinite(value) and value > 0):
                raise ConfigError(f"perception: {field.name} must be a number > 0, got {value!r}")
        if self.grazing_angle >= 90:
            raise ConfigError(f"perception: grazing_angle must be < 90 degrees, got {self.grazing_angle:g}")
