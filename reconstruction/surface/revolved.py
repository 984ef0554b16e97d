"""What is seen of a body of revolution, turned about its axis: a bowl's hidden side is like the one in view.

Cups, bowls, cans, bottles and balls are round, and half of each is hidden. Where circles about one axis go
through what was measured, and no ray passed through these circles elsewhere, the circles are taken to be its
surface all round, and what rays passed at one place to be empty all round. A handle is off the circles and
stays as it was seen.

Knows one object's measured points and readings of its depth image; knows nothing of maps, lattices or meshes.
Points are in the table frame, its z axis vertical; turned, the axis of revolution is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from reconstruction.surface.handle_width import handle_width
from reconstruction.surface.joint_surface import JointEdges, normals_of
from reconstruction.surface.profile_depth import (
    CELL,
    EMPTY,
    NEAR,
    THINNEST,
    depth_table,
    is_vessel,
    no_steeper,
)
from reconstruction.surface.reading import Reading
from reconstruction.surface.round_body import RoundBody
from reconstruction.surface.seen_surface import Edges
from reconstruction.surface.slanted_axis import slanted_axis
from reconstruction.surface.thin_walls import thin_walls
from reconstruction.surface.unseen_cavity import cavity, fill, hollow_out
from reconstruction.surface.unseen_end import with_ends
from reconstruction.surface.vertical_axis import vertical_axis

ANGLES = 24
"""Places around the axis at which rays are asked."""
PASSED, PASSED_BY = 0.004, 0.04
"""A ray has passed through a place that lies this far before what it measured [m], or this share of the
place's radius: nobody knows the axis better."""
PASSED_SHARE = 0.1
"""Circles through which more than this share of the rays passed are not the body's."""
ROUND_SHARE = 0.75
"""At least this share of the measured points is on the body's circles."""
LEAST_ARC = 0.25
"""They are seen from all over at least this share of a turn."""
ARC = 0.004
"""The surface is told all round by points no farther apart than this [m]: no cell of a lattice, between
whose nodes a thin wall lies, is smaller."""
COARSE = 3
"""Rays are asked at one cell in so many along radius and height."""
BEYOND = 0.015
"""The half plane reaches this far beyond the measured points [m]."""
HANDLE = 0.006, 0.015
"""What is seen off the circles is at least and at most this thick [m]."""
MEASURED = 0.0005
"""What lies no farther behind what was measured [m] is read as it was."""
STEEP = 0.05
"""Rays that meet a plane at a smaller sine do not tell where."""

Read = Callable[[np.ndarray], Reading]
"""read(places (..., 3) float32, turned [m]): what was measured says of them."""


@dataclass(frozen=True)
class RevolvedEdges:
    """The edges of a body of revolution: they say more of what is hidden.

    edges: what was measured; body: what it is measured of; circles: (M, 3) points of its surface all round;
    wall: what is measured is at least so thick [m]; handle: what is seen off the circles is no thicker [m];
    full: its unknown inside is taken for more of it.
    """

    never_hollow: ClassVar[bool] = False
    """Many round things are hollow."""
    edges: Edges | JointEdges
    body: RoundBody
    circles: np.ndarray
    wall: float
    handle: float
    full: bool = False

    @classmethod
    def of(
        cls, edges: Edges | JointEdges, points: np.ndarray, normals: np.ndarray, wall: float, upright: bool
    ) -> RevolvedEdges | None:
        """The same for points (N, 3) float32 measured of an object, normals (N, 3) into it; None where it
        is no body of revolution.

        wall: the surface is so thick at least [m]. upright: about a vertical axis, else about any.
        """
        if not upright:
            slanted = slanted_axis(points, normals)
            return None if slanted is None else cls._about(*slanted, edges, points, normals, wall)
        axis = vertical_axis(points, normals)
        return None if axis is None else cls._about(np.eye(3), axis, edges, points, normals, wall)

    @classmethod
    def _about(
        cls,
        turn: np.ndarray,
        axis: np.ndarray,
        edges: Edges | JointEdges,
        points: np.ndarray,
        normals: np.ndarray,
        wall: float,
    ) -> RevolvedEdges | None:
        """The body about one axis; None where points (N, 3) with normals (N, 3) are not of one."""
        turn = turn.astype(np.float32)
        points, normals = points @ turn.T, normals @ turn.T

        def read(places: np.ndarray) -> Reading:
            return edges.read(places.reshape(-1, 3) @ turn)

        offset = points[:, :2] - axis
        radius = np.hypot(*offset.T)
        # Of the points in one cell of the half plane, the first speaks for all.
        cell = (radius / CELL).astype(np.int32) * 100_003 + np.floor(points[:, 2] / CELL).astype(np.int32)
        _, first, of_cell = np.unique(cell, return_index=True, return_inverse=True)
        turned = _around(axis, radius[first], points[first, 2], ANGLES)
        whole = _passed(read, turned, radius[first]) <= PASSED_SHARE
        own = whole[of_cell]
        arc = np.unique((np.arctan2(*offset[own].T) * (ANGLES / 2 / np.pi)).astype(int))
        if own.mean() < ROUND_SHARE or len(arc) < LEAST_ARC * ANGLES:
            return None
        away = offset[own] / np.maximum(radius[own], 1e-6)[:, None]
        inwards = np.stack([(normals[own, :2] * away).sum(1), normals[own, 2]], 1)
        profile = np.stack([radius[own], points[own, 2]], 1)
        low = float(points[:, 2].min()) - BEYOND
        shape = np.ceil(
            np.array([radius.max() + BEYOND, points[:, 2].max() + BEYOND - low]) / (CELL * COARSE)
        )
        empty = _empty(read, axis, low, shape.astype(int))
        depth = depth_table(profile, inwards, low, empty)
        if np.array_equal(turn, np.eye(3)):  # below the floor there is nothing
            rise = edges.above_floor(low + CELL * np.arange(depth.shape[1], dtype=np.float32))
            np.minimum(depth, np.maximum(rise, EMPTY), out=depth, where=rise < 0)
        from_outside = not is_vessel(inwards)
        seen = None if from_outside else thin_walls(depth)
        # The hollow in a foot may be all that is seen of a cup upside down.
        hollow = cavity(profile, inwards, low, empty) if from_outside or (seen and seen.shallow) else None
        if hollow is not None and (seen is None or seen.upper != hollow.upper):
            hollow_out(depth, low, hollow)
        elif from_outside:
            fill(depth)
        no_steeper(depth)
        full = from_outside and hollow is None
        angles = max(ANGLES, int(np.ceil(2 * np.pi * radius.max() / ARC)))
        circles = _around(axis, radius[first][whole], points[first, 2][whole], angles)
        body = RoundBody(turn, axis, low, depth)
        sticks_out = bool((body.depth(points @ turn) < -NEAR).any())
        handle = float(np.clip(handle_width(edges, body) if sticks_out else 0.0, *HANDLE))
        return cls(edges, body, circles.reshape(-1, 3) @ turn, wall, handle, full)

    def ended(self, log_odds: np.ndarray, corner: np.ndarray, spacing: float) -> RevolvedEdges:
        """The same with ends where nobody saw them, by the map's log odds (nx, ny, nz) at
        corner + spacing * (i, j, k) [m, table frame]."""
        body, places = with_ends(self.body, log_odds, corner, spacing, ARC)
        return replace(self, body=body, circles=np.concatenate([self.circles, places]))

    def read(self, points: np.ndarray) -> Reading:
        """What the depth image says of points (N, 3) float32 [m], or the circles where it says nothing."""
        reading = self.edges.read(points)
        hidden = (reading.distance > 0) & (reading.depth > self.wall) & (reading.others > self.wall)
        rows = np.flatnonzero(hidden)
        depth = self.body.depth(points[rows])
        known = depth < NEAR
        rows, depth = rows[known], depth[known]
        behind = reading.depth[rows]
        # What lies close behind a handle is the handle.
        close = np.flatnonzero((depth < 0) & (behind < self.handle))
        if len(close):
            near = points[rows[close]]
            shown = self._shown(near, behind[close], normals_of(self.edges, near))
            off = close[np.abs(self.body.depth(shown)) > NEAR]
            keep = np.ones(len(rows), bool)
            keep[off] = False
            rows, depth, behind = rows[keep], depth[keep], behind[keep]
        reading.distance[rows] = np.minimum(reading.distance[rows], depth)
        within = np.float32(0) if self.full else np.minimum(behind, depth)
        # Outside, the map has no say either: the surface would step from node to node of the lattice.
        reading.depth[rows] = np.where(depth >= 0, within, np.minimum(behind, self.wall - depth))
        self._read_behind_seen(points, reading)
        return reading

    def _read_behind_seen(self, points: np.ndarray, reading: Reading) -> None:
        """The same for points right behind what was measured: a wall ends as smoothly as it goes on."""
        if self.full:
            return
        behind = (reading.depth > MEASURED) & (reading.depth <= self.wall)
        rows = np.flatnonzero(behind & (reading.distance > 0) & (reading.others > self.wall))
        # Less than the thinnest wall, and it would have holes where it does not lie as its circles do.
        deep = np.maximum(self.body.depth(points[rows]), np.float32(THINNEST) - reading.depth[rows])
        ending = deep < reading.distance[rows]
        rows, deep = rows[ending], deep[ending]
        reading.distance[rows] = deep
        reading.depth[rows] = self.wall - deep

    def depth_known(self, points: np.ndarray) -> np.ndarray:
        """How deep points (N, 3) lie in the body (N,) float32 [m], negative outside; NaN where that is not
        known, and close behind what is seen before the body: a handle."""
        depth = self.body.depth(points)
        depth[depth >= NEAR] = np.nan
        beyond = np.flatnonzero(depth < 0)
        handle = self.edges.read(points[beyond]).depth < self.handle
        depth[beyond[handle]] = np.nan
        return depth

    def behind(self, points: np.ndarray, distance: float) -> np.ndarray:
        """Points (M, 3) that the object reaches to: its circles, and points (N, 3) moved by `distance` [m]
        away from the camera."""
        return np.concatenate([self.edges.behind(points, distance), self.circles])

    def above_floor(self, height: np.ndarray) -> np.ndarray:
        """How far heights (N,) are above the floor [m], FAR where none is known."""
        return self.edges.above_floor(height)

    def _shown(self, points: np.ndarray, below: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Where the rays to points (N, 3) meet the planes that they are so far `below` (N,) [m], with normals
        (N, 3) into the object; seen from the first camera, or right before the points on planes that it does
        not see."""
        views = self.edges.views if isinstance(self.edges, JointEdges) else (self.edges,)
        T = views[0].seen.T_camera_table
        rays = points - (-T[:3, :3].T @ T[:3, 3]).astype(np.float32)
        rays /= np.sqrt((rays**2).sum(1, keepdims=True))
        steep = (rays * normals).sum(1, keepdims=True)
        return points - np.where(steep > STEEP, rays / np.maximum(steep, STEEP), normals) * below[:, None]


def _around(axis: np.ndarray, radius: np.ndarray, height: np.ndarray, angles: int) -> np.ndarray:
    """Points (N, angles, 3) float32 at radii and heights (N,) [m], all around the axis."""
    angle = (np.arange(angles) + 0.5) * (2 * np.pi / angles)
    points = np.empty((len(radius), angles, 3), np.float32)
    points[..., 0] = axis[0] + radius[:, None] * np.cos(angle)
    points[..., 1] = axis[1] + radius[:, None] * np.sin(angle)
    points[..., 2] = height[:, None]
    return points


def _passed(read: Read, around: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Share (N,) of places (N, ANGLES, 3) on circles of a radius (N,) [m] that rays passed through."""
    before = -read(around).distance.reshape(around.shape[:2])
    return (before > np.maximum(PASSED, PASSED_BY * radius)[:, None]).mean(1)


def _empty(read: Read, axis: np.ndarray, low: float, shape: np.ndarray) -> np.ndarray:
    """Cells (R, Z) of the half plane, from a height on, that are empty all round; shape: of coarse cells."""
    radius, height = ((np.arange(n) + 0.5) * COARSE * CELL for n in shape)
    places = np.stack(np.meshgrid(radius, low + height, indexing="ij"), -1).reshape(-1, 2)
    passed = _passed(read, _around(axis, places[:, 0], places[:, 1], ANGLES), places[:, 0]) > PASSED_SHARE
    return passed.reshape(shape).repeat(COARSE, 0).repeat(COARSE, 1)
