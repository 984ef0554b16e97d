"""Boxes as meshes and as convex parts."""

from __future__ import annotations

from collections.abc import Sequence

import trimesh

from reconstruction.export.hulls import Hull


def box(size: Sequence[float], middle: Sequence[float]) -> trimesh.Trimesh:
    """A closed mesh with whole lengths `size` (3,) about `middle` (3,) [m]."""
    return trimesh.creation.box(size).apply_translation(middle)


def part(size: Sequence[float], middle: Sequence[float]) -> Hull:
    """The same as a convex part."""
    return Hull.of(box(size, middle))
