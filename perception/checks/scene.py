"""All checks of a frame against its own scene, in the order in which observe asks them. Seconds before any
work."""

from __future__ import annotations

import numpy as np

from perception.checks.depth_kind import check_buffer, check_depth_kind
from perception.checks.depth_values import without_lone_far
from perception.checks.intrinsics import check_cut
from perception.checks.label_regions import LabelRegion, label_regions
from perception.checks.pose import check_pose
from perception.checks.scenery import set_aside
from perception.checks.several_things import in_parts, split_things
from perception.checks.unit import check_unit, scale_of
from perception.config import PerceptionConfig
from perception.frame import Frame
from perception.observation import Skipped, SupportPlane

LONE_NOTE = 50
"""So many lone far pixels are worth a note."""


def check_depth(frame: Frame, seed: int) -> tuple[np.ndarray, list[str]]:
    """Depth (H, W) [m] without lone far pixels, and notes. Raises FrameError when it is not z in metres."""
    depth, lone = without_lone_far(frame.depth, frame.labels)
    check_depth_kind(depth, frame.camera, frame.source, np.random.default_rng(seed), "kind" in frame.trust)
    if lone < LONE_NOTE:
        return depth, []
    return depth, [f"{lone} lone depth pixels lie far behind everything around them: taken as missing"]


def screen_labels(
    frame: Frame, points: np.ndarray, config: PerceptionConfig
) -> tuple[np.ndarray, list[LabelRegion], list[Skipped], list[str]]:
    """Labels (H, W) of things that can be mapped together, where they are, what was set aside, and notes.

    points: (H, W, 3) [m] in the camera frame. Raises FrameError when the unit of depth must be wrong.
    """
    assert frame.labels is not None
    regions = label_regions(points, frame.labels)
    labels, aside = set_aside(points, frame.labels, regions, config)
    gone = {label for label, _ in aside}
    regions = [item for item in regions if item.label not in gone]
    if regions:
        check_unit(scale_of(regions, frame.camera), frame.source, "unit" in frame.trust)
    skipped = [Skipped(label, frame.name_of(label), reason) for label, reason in aside]
    notes = check_buffer(frame.depth, regions, frame.source, "kind" in frame.trust)
    return labels, regions, skipped, notes


def check_support(frame: Frame, regions: list[LabelRegion], support: SupportPlane) -> list[str]:
    """Notes about unit and pose, now that the support is known. Raises FrameError when one must be wrong."""
    check_cut(frame.camera, support.normal, frame.source, "K" in frame.trust)
    notes = check_pose(frame.camera, support, frame.source, "pose" in frame.trust)
    if regions:
        scale = scale_of(regions, frame.camera, support.normal, support.offset)
        notes += check_unit(scale, frame.source, "unit" in frame.trust)
    return notes


def split_numbers(
    frame: Frame,
    points: np.ndarray,
    labels: np.ndarray,
    regions: list[LabelRegion],
    support: SupportPlane,
    config: PerceptionConfig,
) -> tuple[np.ndarray, Frame, list[str]]:
    """Labels (H, W) with a number for every thing, the frame with names for the new ones, and notes."""
    if not any(in_parts(item) for item in regions):
        return labels, frame, []
    labels, origin = split_things(points, labels, support, frame.camera, config)
    notes, names, count = [], {}, dict.fromkeys(origin.values(), 1)
    for new, old in origin.items():
        count[old] += 1
        names[new] = f"{frame.name_of(old)}_{count[old]}"
        notes.append(
            f"label {old} ({frame.name_of(old)}) covers several things: one of them is label {new} now"
        )
    return labels, frame.renamed(names), notes
