"""The unit of depth against the scene: how large things are, how far, and where the world has its table.

A wrong unit scales sizes and distances alike, so things and distances that are both odd in the same way tell
it. The likeliest right unit is offered in the message, never taken.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapping.errors import FrameError
from perception.camera import Camera
from perception.checks.label_regions import LabelRegion

USUAL_SIZE = (0.13, 0.55)
"""Median length of things on tables [m], and its spread as a logarithm."""
USUAL_DISTANCE = (0.7, 0.5)
"""Median distance of a camera to them [m], and its spread as a logarithm."""
FACTORS = (0.001, 0.01, 0.1, 10 / 65.535, 0.25, 0.4, 0.5, 2.0, 2.5, 4.0, 6.5535, 10.0, 100.0, 1000.0)
"""Units that are confused: metre, centimetre, millimetre, 0.1 mm, 0.25 mm, 0.4 mm, and 10 m over 16 bits."""
AT_ZERO = 0.015
"""A table this near to z = 0 of the world lies there on purpose [m]."""
ZERO_WEIGHT = 6.0
"""What that counts for, in the squared deviations added up."""
REFUSE, NOTE = 9.0, 4.0
"""By how much the other unit must be likelier for a refusal, and for a note."""
AGREE = 0.27
"""A factor is named where sizes and distances, each alone, ask for it to this logarithm, or a table lies at
z = 0 then; a wrong one is worse than none."""
CLEAR = 0.6
"""... and no other factor is nearly as likely."""
RIVALS = 3.0
"""Otherwise all that are not less likely than the best by more than this are named."""


@dataclass(frozen=True)
class Scale:
    """Median length of the things [m], their distance [m], and the table's height below the camera along z
    of the
    world with the camera's own height in the world [m], where a pose and a level table are known."""

    size: float
    distance: float
    camera_over_table: float | None = None
    camera_height: float | None = None

    def oddness(self, factor: float) -> float:
        """Squared deviations from what is usual, if depth were `factor` times what it is."""
        size = np.log(factor * self.size / USUAL_SIZE[0]) / USUAL_SIZE[1]
        distance = np.log(factor * self.distance / USUAL_DISTANCE[0]) / USUAL_DISTANCE[1]
        return float(size**2 + distance**2 - (ZERO_WEIGHT if self._at_zero(factor) else 0.0))

    def asks_for(self, factor: float) -> bool:
        """Whether two kinds of evidence agree on a factor."""
        size = abs(np.log(factor * self.size / USUAL_SIZE[0]))
        distance = abs(np.log(factor * self.distance / USUAL_DISTANCE[0]))
        return self._at_zero(factor) or bool(max(size, distance) < AGREE)

    def _at_zero(self, factor: float) -> bool:
        if self.camera_over_table is None or self.camera_height is None:
            return False
        return abs(self.camera_height - factor * self.camera_over_table) < AT_ZERO * max(1.0, factor)


def scale_of(
    regions: list[LabelRegion], camera: Camera, normal: np.ndarray | None = None, offset: float = 0.0
) -> Scale:
    """The scale of a scene; normal (3,), offset [m]: the support plane in the camera frame."""
    size = float(np.median([item.sides[0] for item in regions]))
    distance = float(np.median([item.distance for item in regions]))
    R, t = camera.T_world_camera[:3, :3], camera.T_world_camera[:3, 3]
    if normal is None or not t.any() or (R @ normal)[2] < 0.99:
        return Scale(size, distance)
    return Scale(size, distance, offset, float(t[2]))


def check_unit(scale: Scale, source: str, trusted: bool) -> list[str]:
    """A note about the unit, or none; raises FrameError when another unit is much likelier. Costs nothing."""
    present = scale.oddness(1.0)
    odds = [scale.oddness(factor) for factor in FACTORS]
    best = int(np.argmin(odds))
    gain = present - odds[best]
    if trusted or gain < NOTE:
        return []
    factor = FACTORS[best]
    clear = scale.asks_for(factor) and sorted(odds)[1] - odds[best] > CLEAR
    rivals = [of for of, odd in zip(FACTORS, odds) if odd < odds[best] + RIVALS]
    offer = f"{factor:.4g}" if clear else " or ".join(f"{of:.4g}" for of in rivals)
    what = (
        f"the things are {_length(scale.size)} long (median) at {_length(scale.distance)}: a wrong unit of "
        f"depth? With depth_scale times {offer} they are "
        f"{_range(scale.size, [factor] if clear else rivals)} long at "
        f"{_range(scale.distance, [factor] if clear else rivals)}"
    )
    if clear and scale.oddness(factor) < 0 < present:
        what += " and the table lies at z = 0"
    if gain > REFUSE:
        raise FrameError(
            f'{source}: {what}. Set depth_scale so; if depth is right, add "trust": ["unit"] to the camera '
            "file (--trust unit)"
        )
    return [f"{what}; nothing was changed"]


def _range(metres: float, factors: list[float]) -> str:
    """A length under each factor."""
    return " or ".join(_length(metres * factor) for factor in factors)


def _length(metres: float) -> str:
    return f"{1000 * metres:.0f} mm" if metres < 0.1 else f"{metres:.2g} m"
