"""Settings of perception: one dataclass whose field texts are also the command line's help."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from mapping.settings import Checked, Count, Length, OpenShare, Positive, Range


@dataclass(frozen=True)
class PerceptionConfig(Checked):
    """How a frame is cleaned and what counts as free, surface and occluded. Lengths in metres."""

    SECTION: ClassVar[str] = "perception"

    minimum_pixels: Count = 30
    """An object with fewer valid pixels than this is skipped and listed."""
    depth_noise: Length = 0.0025
    """Standard deviation of measured depth at 1 m [m]; it grows with the square of the depth."""
    grazing_angle: Annotated[float, Range(above=0, below=90)] = 82.0
    """Depth steps steeper than a surface seen at this angle to its normal [degrees] are jumps."""
    remove_flying_pixels: bool = True
    """Remove pixels that hang between a near and a far surface."""
    use_plane: bool = True
    """Look for the support plane; without it the table frame is the camera frame."""
    plane_threshold: Length = 0.01
    """Distance of a point to the support plane that still counts as on it [m]."""
    plane_points: Count = 1500
    """Points that the plane search looks at."""
    plane_iterations: Count = 150
    """RANSAC iterations for each candidate plane."""
    plane_candidates: Count = 4
    """Planes tried before the best one below the objects is taken."""
    plane_reach: Length = 0.25
    """The plane is looked for within this distance of the objects first [m]."""
    plane_minimum_share: OpenShare = 0.08
    """A plane with a smaller share of the points near the objects is not convincing."""
    table_margin: Length = 0.003
    """Labelled points nearer to the support plane than this are label bleed onto the table [m]."""
    flat_height: Length = 0.008
    """An object no higher than this is flat: only points at or under the plane are taken from it [m]."""
    cluster_gap: Length = 0.012
    """Pieces of one object nearer to each other than about this are one cluster [m]."""
    split_gap: Length = 0.15
    """Pieces parted by something in front of them belong together up to this gap [m]."""
    segment_height: Length = 0.012
    """Without labels, what stands higher than this above the support plane is an object [m]."""
    segment_reach: Length = 0.35
    """Without labels, only what lies within this height above a plane speaks for it as the support [m]."""
    segment_float: Length = 0.25
    """Without labels, a piece that begins higher than this above the support does not stand on it [m]."""
    segment_minimum_area: Positive = 4e-4
    """Without labels, a piece with less visible surface than this is no object [m^2]."""
    largest_object: Length = 1.5
    """A label on something larger than this is skipped: it is furniture, a person, a wall [m]."""
    other_reach: Length = 0.3
    """Surfaces without a label are obstacles of the map within this distance of objects [m]."""
    surface_margin: Length = 0.004
    """Points within this depth of a measured surface lie on it, more at long range [m]."""
