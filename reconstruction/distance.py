"""Distance fields: how far is the nearest surface, which way, and is it known there?

Knows closed meshes, a lattice, and a map that says how unsure it is; knows nothing of frames or files. Exact
at the lattice's nodes near surfaces, interpolated between them: a hundred times faster than asking the
meshes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh

from mapping.contramap import ContraMap
from mapping.errors import ConfigError, DataError
from perception.camera import invert_rigid, transform
from reconstruction.solid import Solid

COARSEST = 2
"""Nodes are worked out one by one only near surfaces, and every 2nd of them everywhere."""
BEND = 3.0
"""Between nodes of some step, distances larger than this many steps are interpolated: wrong by 1/16 step at
most."""


@dataclass(frozen=True)
class DistanceConfig:
    """The lattice that distances are read from."""

    spacing: float = 0.005
    """Distance of its nodes [m]; coarser where it would get more than `nodes` of them."""
    margin: float = 0.10
    """It reaches this far beyond the meshes [m]."""
    nodes: int = 1_500_000
    """Most nodes."""
    unknown_above: float = 0.5
    """p(uncertain) above which a place counts as unknown."""


@dataclass(frozen=True)
class Distances:
    """The answer at N points.

    distance: (N,) float32 [m] to the nearest surface, negative inside; gradient: (N, 3) float32, the
    direction in which it grows, of length 1 but near edges of its change; unknown: (N,) bool, where the map
    says that nobody has seen what is there, inside of objects as well.
    """

    distance: np.ndarray
    gradient: np.ndarray
    unknown: np.ndarray


class DistanceField:
    """Signed distance to closed meshes on a lattice in the table frame, asked with points of the world frame.

    distance: (nx, ny, nz) float32 [m] at nodes origin + spacing * (i, j, k); unknown: the same, bool.
    """

    def __init__(
        self,
        meshes: Sequence[trimesh.Trimesh],
        T_world_table: np.ndarray,
        model: ContraMap | None,
        config: DistanceConfig | None = None,
    ) -> None:
        """meshes: [m, world frame]; model: the map, in the table frame; without one all places are known."""
        config = config or DistanceConfig()
        if not meshes:
            raise DataError("no mesh to measure distances from")
        self.T_world_table = T_world_table
        T_table_world = invert_rigid(T_world_table)
        local = [
            trimesh.Trimesh(
                transform(T_table_world, np.asarray(mesh.vertices, float)), mesh.faces, process=False
            )
            for mesh in meshes
        ]
        low = np.min([mesh.bounds[0] for mesh in local], axis=0) - config.margin
        high = np.max([mesh.bounds[1] for mesh in local], axis=0) + config.margin
        self.spacing = max(config.spacing, float(np.cbrt(np.prod(high - low) / config.nodes)))
        # Multiples of the spacing, as the lattices of meshes are.
        self.origin = np.floor(low / self.spacing) * self.spacing
        self.shape = tuple(int(n) for n in np.ceil((high - self.origin) / self.spacing) + 1)
        self.distance = _signed_distances(local, self.origin, self.spacing, self.shape)
        self.unknown = self._unknown(model, config.unknown_above)

    def __call__(self, points: np.ndarray) -> Distances:
        """Distances at points (N, 3) [m, world frame].

        Beyond the lattice the distance is that of its nearest place plus the way there, and all is unknown.
        Raises DataError unless points are finite (N, 3).
        """
        points = np.asarray(points)
        if points.ndim != 2 or points.shape[1] != 3:
            raise DataError(f"points must have shape (N, 3), got {points.shape}")
        R = self.T_world_table[:3, :3]
        place = ((points - self.T_world_table[:3, 3]) @ R - self.origin) / self.spacing  # in nodes
        if not np.isfinite(place).all():
            raise DataError("points hold NaN or infinite values")
        axes = np.ascontiguousarray(place.T, np.float32)
        size = np.array(self.shape, np.float32)[:, None]
        inside = np.minimum(np.maximum(axes, 0), size - 1.001)
        distance, slope = _interpolate(self.distance, inside)
        slope /= self.spacing
        nearest = (inside + np.float32(0.5)).astype(np.int32)
        unknown = self.unknown[tuple(nearest)]
        beyond = np.flatnonzero((axes != inside).any(0))
        if len(beyond):
            distance[beyond], slope[:, beyond] = _beyond(
                (axes - inside)[:, beyond] * self.spacing, distance[beyond], slope[:, beyond]
            )
            unknown[beyond] = True
        return Distances(distance, slope.T @ R.T.astype(np.float32), unknown)

    def _unknown(self, model: ContraMap | None, above: float) -> np.ndarray:
        if model is None:
            return np.zeros(self.shape, bool)
        # Every second node: what is known changes over centimetres.
        axes = tuple(self.origin[i] + self.spacing * np.arange(0, n + 1, 2) for i, n in enumerate(self.shape))
        coarse = model.predict_lattice(axes)[..., -1] > above
        whole = coarse.repeat(2, 0).repeat(2, 1).repeat(2, 2)
        return np.ascontiguousarray(whole[tuple(slice(0, n) for n in self.shape)])


def distance_to(
    meshes: dict[int, trimesh.Trimesh], label: int | None, T_world_table: np.ndarray, model: ContraMap | None
) -> DistanceField:
    """The field of one object, or of all for None; raises ConfigError for a label that no object has."""
    if label is not None and label not in meshes:
        raise ConfigError(f"no object has label {label}; there are {', '.join(map(str, meshes))}")
    chosen = list(meshes.values()) if label is None else [meshes[label]]
    return DistanceField(chosen, T_world_table, model)


def _signed_distances(
    meshes: list[trimesh.Trimesh], origin: np.ndarray, spacing: float, shape: tuple[int, ...]
) -> np.ndarray:
    """(nx, ny, nz) float32 [m], negative inside: exact near surfaces, interpolated from fewer nodes farther
    away.

    Distances bend little far from a surface: every 2nd node tells them there.
    """
    together = trimesh.util.concatenate(meshes)
    assert isinstance(together, trimesh.Trimesh)
    surface, solids = Solid(together), [Solid(mesh) for mesh in meshes]

    def exact(nodes: np.ndarray, step: int) -> np.ndarray:
        points = (origin + spacing * step * nodes).astype(np.float32)
        distance = surface.distance(points)
        inside = np.any([solid.inside(points) for solid in solids], axis=0)
        return np.where(inside, -distance, distance)

    coarse = tuple(-(-(n - 1) // COARSEST) + 1 for n in shape)
    values = exact(np.stack(list(np.indices(coarse)), -1), COARSEST)
    step = COARSEST
    while step > 1:
        values = _twice_as_fine(values)
        near = np.abs(values) < BEND * step * spacing
        step //= 2
        values[near] = exact(np.argwhere(near), step)
    return np.ascontiguousarray(values[tuple(slice(0, n) for n in shape)])


def _twice_as_fine(values: np.ndarray) -> np.ndarray:
    """The lattice with a node halfway between each two, interpolated."""
    for axis in range(values.ndim):
        ends = np.moveaxis(values, axis, 0)
        finer = np.empty((2 * len(ends) - 1, *ends.shape[1:]), np.float32)
        finer[::2] = ends
        finer[1::2] = (ends[:-1] + ends[1:]) / 2
        values = np.moveaxis(finer, 0, axis)
    return np.ascontiguousarray(values)


def _interpolate(lattice: np.ndarray, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Trilinear values (N,) and their slopes (3, N) per node at places (3, N) float32 within the lattice."""
    first = place.astype(np.int32)
    x, y, z = place - first
    _, ny, nz = lattice.shape
    base = (first[0] * ny + first[1]) * nz + first[2]
    flat = lattice.reshape(-1)
    corner = [[flat[base + (i * ny + j) * nz + k] for k in (0, 1)] for i in (0, 1) for j in (0, 1)]
    dz = [b - a for a, b in corner]
    at_z = [a + z * d for (a, _), d in zip(corner, dz)]
    dy = [at_z[1] - at_z[0], at_z[3] - at_z[2]]
    at_y = [at_z[0] + y * dy[0], at_z[2] + y * dy[1]]
    dzy = [dz[0] + y * (dz[1] - dz[0]), dz[2] + y * (dz[3] - dz[2])]
    dx = at_y[1] - at_y[0]
    slope = np.stack([dx, dy[0] + x * (dy[1] - dy[0]), dzy[0] + x * (dzy[1] - dzy[0])])
    return at_y[0] + x * dx, slope


def _beyond(way: np.ndarray, distance: np.ndarray, slope: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance (N,) and gradient (3, N) at the end of ways (3, N) [m] that lead out of the lattice."""
    length = np.linalg.norm(slope, axis=0)
    back = slope / np.maximum(length, 1e-6) * distance
    from_surface = way + back
    far = np.linalg.norm(from_surface, axis=0)
    return far.astype(np.float32), (from_surface / np.maximum(far, 1e-9)).astype(np.float32)
