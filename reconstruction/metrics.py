"""How well shapes agree with the truth: IoU, Chamfer distance, F-score, for meshes and points in metres."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from mapping.errors import DataError
from reconstruction.solid import Solid

SURFACE_SAMPLES = 10_000
"""Points drawn on a mesh to compare it with another."""


def inside(mesh: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    """Which points (..., 3) [m] lie inside a closed mesh: (...) bool."""
    return Solid(mesh).inside(points)


def distance_to_surface(mesh: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    """Distance [m] of points (..., 3) to the nearest point of the mesh's surface: (...) float32."""
    return Solid(mesh).distance(points)


def grid_around(center: np.ndarray, extent: float = 0.4, spacing: float = 0.015) -> np.ndarray:
    """Lattice points (n, n, n, 3) [m] of a cube of side `extent` centred on `center` (3,)."""
    count = round(extent / spacing) + 1
    axis = (np.arange(count) - (count - 1) / 2) * spacing
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    return grid + np.asarray(center)


def iou(predicted: np.ndarray, true: np.ndarray) -> float:
    """Intersection over union of two bool arrays of one shape; 1 when both are empty."""
    predicted, true = np.asarray(predicted, bool), np.asarray(true, bool)
    if predicted.shape != true.shape:
        raise DataError(f"both must have one shape, got {predicted.shape} and {true.shape}")
    union = np.logical_or(predicted, true).sum()
    return float(np.logical_and(predicted, true).sum() / union) if union else 1.0


def iou_on_grid(predicted: np.ndarray, true_mesh: trimesh.Trimesh, points: np.ndarray) -> float:
    """IoU of predicted occupancy (...) bool at points (..., 3) [m] with the inside of the true mesh."""
    return iou(predicted, inside(true_mesh, points))


def mesh_iou(a: Solid | trimesh.Trimesh, b: Solid | trimesh.Trimesh, spacing: float = 0.005) -> float:
    """IoU of the insides of two closed meshes, counted on a grid of `spacing` [m] over both of them."""
    a, b = (item if isinstance(item, Solid) else Solid(item) for item in (a, b))
    low = np.minimum(a.mesh.bounds[0], b.mesh.bounds[0])
    high = np.maximum(a.mesh.bounds[1], b.mesh.bounds[1])
    axes = [np.arange(o + spacing / 2, h, spacing) for o, h in zip(low, high)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    return iou(a.inside(grid), b.inside(grid))


def sample_surface(mesh: trimesh.Trimesh, count: int, rng: np.random.Generator) -> np.ndarray:
    """Points (count, 3) [m], uniform on the mesh's surface."""
    if len(mesh.faces) == 0:
        raise DataError("the mesh has no triangles")
    corners = np.asarray(mesh.triangles)
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    chosen = corners[rng.choice(len(corners), size=count, p=areas / areas.sum())]
    u, v = np.sqrt(rng.random((count, 1))), rng.random((count, 1))
    return (1 - u) * chosen[:, 0] + u * (1 - v) * chosen[:, 1] + u * v * chosen[:, 2]


def mutual_distances(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance [m] from each point of a (N, 3) to the nearest of b (M, 3), and the other way: (N,), (M,)."""
    return _nearest(a, b), _nearest(b, a)


def chamfer_of_distances(distances: tuple[np.ndarray, np.ndarray]) -> float:
    """Chamfer distance [m] from `mutual_distances`: the sum of both means, unsquared."""
    return float(distances[0].mean() + distances[1].mean())


def chamfer_of_points(a: np.ndarray, b: np.ndarray) -> float:
    """Mean nearest distance from a (N, 3) to b (M, 3) plus that from b to a [m], unsquared."""
    return chamfer_of_distances(mutual_distances(a, b))


def chamfer(
    mesh_a: trimesh.Trimesh,
    mesh_b: trimesh.Trimesh,
    rng: np.random.Generator,
    samples: int = SURFACE_SAMPLES,
) -> float:
    """Chamfer distance [m] of two meshes from surface samples: mean(a->b) + mean(b->a), unsquared."""
    return chamfer_of_points(sample_surface(mesh_a, samples, rng), sample_surface(mesh_b, samples, rng))


def fscore_of_distances(distances: tuple[np.ndarray, np.ndarray], threshold: float) -> float:
    """F-score from `mutual_distances` of predicted and true points: the harmonic mean of the shares of
    both within `threshold` [m]."""
    precision, recall = (float((part <= threshold).mean()) for part in distances)
    return 2 * precision * recall / (precision + recall) if precision + recall else 0.0


def fscore_of_points(predicted: np.ndarray, true: np.ndarray, threshold: float) -> float:
    """Harmonic mean of precision and recall of points within `threshold` [m] of the other set."""
    return fscore_of_distances(mutual_distances(predicted, true), threshold)


def fscore(
    predicted: trimesh.Trimesh,
    true: trimesh.Trimesh,
    threshold: float,
    rng: np.random.Generator,
    samples: int = SURFACE_SAMPLES,
) -> float:
    """F-score of two meshes at `threshold` [m] from surface samples."""
    return fscore_of_points(
        sample_surface(predicted, samples, rng), sample_surface(true, samples, rng), threshold
    )


def split_visible(
    points: np.ndarray, surface: np.ndarray, reach: float = 0.01
) -> tuple[np.ndarray, np.ndarray]:
    """Which points (N, 3) [m] are near what the camera saw, and which are hidden: two (N,) bool arrays.

    surface: (M, 3) measured surface points [m]; near means within `reach` [m].
    """
    if len(surface) == 0:
        visible = np.zeros(len(points), bool)
    else:
        visible = np.isfinite(_nearest(points, surface, reach))
    return visible, ~visible


def hidden_and_visible_error(
    predicted: Solid | trimesh.Trimesh,
    true: trimesh.Trimesh,
    surface: np.ndarray,
    rng: np.random.Generator,
    samples: int = SURFACE_SAMPLES,
    reach: float = 0.01,
) -> dict[str, float]:
    """Mean distance [m] from the true surface to the predicted mesh, for its visible and hidden parts apart.

    Returns {"visible": ..., "hidden": ...}; NaN for a part that does not exist.
    """
    points = sample_surface(true, samples, rng)
    solid = predicted if isinstance(predicted, Solid) else Solid(predicted)
    distance = solid.distance(points)
    visible, hidden = split_visible(points, surface, reach)
    return {
        name: float(distance[part].mean()) if part.any() else float("nan")
        for name, part in (("visible", visible), ("hidden", hidden))
    }


def _nearest(points: np.ndarray, others: np.ndarray, reach: float = np.inf) -> np.ndarray:
    """Distance (N,) to the nearest of the others; infinite beyond `reach`."""
    _check_points(points)
    _check_points(others)
    return cKDTree(others).query(points, distance_upper_bound=reach)[0]


def _check_points(points: Sequence | np.ndarray) -> None:
    shape = np.shape(points)
    if len(shape) != 2 or shape[1] != 3 or shape[0] == 0:
        raise DataError(f"points must be a non-empty array (N, 3) in metres, got shape {shape}")
