"""tf: where frames are in each other, at any time that its messages cover.

Knows transforms between named frames over time; knows nothing of bags or images.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mapping.errors import FrameError
from perception.camera import invert_rigid
from perception.inputs.pose import compose

MOST_GAP = 1.0
"""Between messages farther apart than this nothing is known [s]."""
SLACK = 0.02
"""A stamp may lie this far before the first message or after the last [s]."""
SECOND = 10**9


@dataclass
class Edge:
    """One frame in its parent. stamps [ns]; values: x y z qx qy qz qw [m]; still: from tf_static."""

    parent: str
    still: bool
    stamps: list[int] = field(default_factory=list)
    values: list[tuple[float, ...]] = field(default_factory=list)

    def at(self, stamp: int, child: str) -> np.ndarray:
        """T_parent_child (4, 4) at a time [ns], interpolated. Raises FrameError when it is not covered."""
        if self.still:
            return _matrix(self.values[-1])
        order = np.argsort(self.stamps, kind="stable")
        stamps = np.array(self.stamps)[order]
        first, last = int(stamps[0]), int(stamps[-1])
        if not first - SLACK * SECOND <= stamp <= last + SLACK * SECOND:
            raise FrameError(
                f"tf says where {child} is from {first / SECOND:.3f} to {last / SECOND:.3f} s, not at "
                f"{stamp / SECOND:.3f} s; take a frame of that time"
            )
        after = int(np.clip(np.searchsorted(stamps, stamp), 0, len(stamps) - 1))
        if stamps[after] == stamp or stamp > last or stamp < first:
            return _matrix(self.values[order[after]])
        a, b = int(stamps[after - 1]), int(stamps[after])
        if b - a > MOST_GAP * SECOND:
            raise FrameError(
                f"tf says nothing of where {child} is for {(b - a) / SECOND:.1f} s around "
                f"{stamp / SECOND:.3f} s; take a frame of another time"
            )
        return _between(self.values[order[after - 1]], self.values[order[after]], (stamp - a) / (b - a))


class Transforms:
    """All transforms of a bag."""

    def __init__(self) -> None:
        self.edges: dict[str, Edge] = {}

    def add(self, transforms: Iterable[Any], still: bool) -> None:
        """Take up geometry_msgs/TransformStamped messages."""
        for one in transforms:
            child, parent = str(one.child_frame_id).lstrip("/"), str(one.header.frame_id).lstrip("/")
            edge = self.edges.get(child)
            if edge is None or edge.parent != parent:
                edge = self.edges[child] = Edge(parent, still)
            t, q, stamp = one.transform.translation, one.transform.rotation, one.header.stamp
            edge.stamps.append(int(stamp.sec) * SECOND + int(stamp.nanosec))
            edge.values.append((t.x, t.y, t.z, q.x, q.y, q.z, q.w))

    @property
    def frames(self) -> list[str]:
        """All frames that tf names."""
        return sorted({*self.edges, *(edge.parent for edge in self.edges.values())})

    def root(self, frame: str) -> str:
        """The frame at the top of the tree that a frame is in."""
        return self._chain(frame)[-1]

    def pose(self, frame: str, fixed: str, stamp: int) -> np.ndarray:
        """T_fixed_frame (4, 4) at a time [ns]. Raises FrameError when tf does not say it."""
        if frame == fixed:
            return np.eye(4)
        ours, theirs = self._chain(frame), self._chain(fixed)
        if ours[-1] != theirs[-1]:
            raise FrameError(
                f"tf does not say where {frame} is in {fixed}; its frames are: {', '.join(self.frames)}. "
                f"Name the fixed frame (--bag.fixed-frame), or {frame} itself where the camera stands still"
            )
        T_root_fixed = self._to_root(theirs, stamp)
        return np.asarray(invert_rigid(T_root_fixed) @ self._to_root(ours, stamp))

    def _to_root(self, chain: list[str], stamp: int) -> np.ndarray:
        T = np.eye(4)
        for child in chain[:-1]:
            T = self.edges[child].at(stamp, child) @ T
        return T

    def _chain(self, frame: str) -> list[str]:
        """The frame, its parent, and on to the root."""
        chain = [frame]
        while chain[-1] in self.edges:
            parent = self.edges[chain[-1]].parent
            if parent in chain:
                raise FrameError(f"tf goes round in a circle: {' -> '.join([*chain, parent])}")
            chain.append(parent)
        return chain


def _matrix(value: tuple[float, ...]) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return compose(Rotation.from_quat(value[3:]).as_matrix(), np.array(value[:3]))


def _between(a: tuple[float, ...], b: tuple[float, ...], share: float) -> np.ndarray:
    """The pose a share of the way from a to b, turned about one axis."""
    from scipy.spatial.transform import Rotation, Slerp

    turn = Slerp([0.0, 1.0], Rotation.from_quat([a[3:], b[3:]]))(share)
    place = (1 - share) * np.array(a[:3]) + share * np.array(b[:3])
    return compose(turn.as_matrix(), place)
