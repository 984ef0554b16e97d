"""The surface card: is a delivered mesh right where it was seen, in one piece, and as thin as it should be?

Knows true meshes and the frame; DESIGN.md defines the measures.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from perception.camera import invert_rigid
from reconstruction.metrics import SURFACE_SAMPLES
from reconstruction.solid import Solid
from reconstruction.surface.agreement import Agreement, agreement_with_depth
from tools.evaluation.case import Case
from tools.evaluation.handles import handles_and_parts, true_handles
from tools.evaluation.vessels import is_vessel, outside_seen

SEEN_REACH = 0.004
"""Normals are compared where the mesh is this near to a seen point [m]."""
TRUE_SAMPLES = 40_000
"""Points on the true surface with their normals."""
NEIGHBOURS = 5
"""The best of so many nearest true points counts, so that thin walls are not judged by their other side."""
WALL = 0.015
"""What is no thicker than this, along the ray or across, is a wall [m]."""
WALL_RAYS = 4000
"""Rays that measure an object's walls, at most."""
BEHIND = 1e-5
"""The second ray of a wall starts so far behind the first hit [m]."""
BEFORE = 0.005
"""Rays across a wall start so far before it [m]."""
FINEST_SPACING = 0.0025
"""Grid of the finest IoU [m]."""
SHARP = 45.0
"""Edges at which two triangles are bent by more than this [degrees] are creases."""
HALF = 0.5
"""Handles of vessels are judged apart where this share of the outside is seen."""


def agreements(meshes: dict[int, trimesh.Trimesh], case: Case) -> dict[int, Agreement]:
    """Agreement of meshes [m, table frame] with the frame as it was given, before any cleaning."""
    frame = case.frame
    assert frame.labels is not None
    T_camera_table = invert_rigid(case.observation.T_table_camera)
    return agreement_with_depth(meshes, frame.labels, frame.depth, frame.camera, T_camera_table)


def surface_card(
    mesh: trimesh.Trimesh,
    predicted: Solid,
    true: Solid,
    seen: np.ndarray,
    origin: np.ndarray,
    rng: np.random.Generator,
) -> dict[str, Any]:
    """Measures of one mesh against its true one: normals on what was seen, genus, parts, creases, walls.

    seen: (N, 3) measured points [m]; origin: (3,) the camera's centre, in the meshes' frame.
    """
    handles, parts = handles_and_parts(mesh)
    # Scans with texture have vertices twice along its seams.
    whole = trimesh.Trimesh(true.mesh.vertices, true.mesh.faces, process=True)
    wanted = true_handles(true)
    right = None if handles is None else float(handles == wanted)
    vessel = is_vessel(true)
    shown = vessel and outside_seen(true.mesh, seen) >= HALF
    return {
        "normal_deg": normal_error(mesh, true.mesh, seen, rng),
        "handles": handles,
        "true_handles": wanted,
        "handles_right": right,
        "vessel_handles_right": right if shown else None,
        "parts": parts,
        "true_parts": handles_and_parts(whole)[1],
        "creases_excess_per_m": creases_per_m(mesh) - creases_per_m(whole),
        **wall_excess(predicted, true, seen, origin, rng),
        "vessel_wall_mm": excess_across(predicted, true, seen, rng) if vessel else None,
    }


def normal_error(
    mesh: trimesh.Trimesh, true: trimesh.Trimesh, seen: np.ndarray, rng: np.random.Generator
) -> float | None:
    """Mean angle [degrees] between a mesh's normals near seen points (N, 3) and the true ones, for each point
    the best of the NEIGHBOURS nearest; None when the mesh is nowhere near."""
    points, normals = surface_with_normals(mesh, SURFACE_SAMPLES, rng)
    near = np.isfinite(cKDTree(seen).query(points, distance_upper_bound=SEEN_REACH)[0])
    if not near.any():
        return None
    true_points, true_normals = surface_with_normals(true, TRUE_SAMPLES, rng)
    _, nearest = cKDTree(true_points).query(points[near], k=NEIGHBOURS)
    cosine = np.einsum("nkd,nd->nk", true_normals[nearest], normals[near]).max(1)
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean())


def creases_per_m(mesh: trimesh.Trimesh) -> float:
    """Length of creases over the area of a mesh [1/m]: a cube of 10 cm has 20; teeth and terraces add."""
    bent = mesh.face_adjacency_angles > np.radians(SHARP)
    edges = np.asarray(mesh.vertices)[mesh.face_adjacency_edges[bent]]
    return float(np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1).sum() / mesh.area)


def surface_with_normals(
    mesh: trimesh.Trimesh, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Points (count, 3) uniform on a mesh, and the unit normals (count, 3) of their triangles."""
    corners = np.asarray(mesh.triangles)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(normals, axis=1)
    chosen = rng.choice(len(corners), size=count, p=areas / areas.sum())
    u, v = np.sqrt(rng.random((count, 1))), rng.random((count, 1))
    a, b, c = corners[chosen].transpose(1, 0, 2)
    return (1 - u) * a + u * (1 - v) * b + u * v * c, normals[chosen] / areas[chosen, None]


def wall_excess(
    predicted: Solid, true: Solid, seen: np.ndarray, origin: np.ndarray, rng: np.random.Generator
) -> dict[str, float | None]:
    """How much thicker walls are than true [mm], along rays through seen points (N, 3) from origin (3,).

    wall_excess_mm: mean over the rays on which the true object is no thicker than WALL; wall_share: their
    share. None where there are none.
    """
    targets = _some(seen, rng)
    directions = targets - origin
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    start = np.broadcast_to(origin, directions.shape)
    excess, share = _excess(predicted, true, start, directions)
    return {"wall_excess_mm": excess, "wall_share": share}


def excess_across(predicted: Solid, true: Solid, seen: np.ndarray, rng: np.random.Generator) -> float | None:
    """How much thicker walls are than true [mm], across the true wall at seen points (N, 3): mean over the
    places where the true one is no thicker than WALL; None where there are none."""
    surface, normals = surface_with_normals(true.mesh, TRUE_SAMPLES, rng)
    _, nearest = cKDTree(surface).query(_some(seen, rng))
    outward = normals[nearest]
    return _excess(predicted, true, surface[nearest] + BEFORE * outward, -outward)[0]


def _some(seen: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return seen if len(seen) <= WALL_RAYS else seen[rng.choice(len(seen), WALL_RAYS, replace=False)]


def _excess(
    predicted: Solid, true: Solid, start: np.ndarray, directions: np.ndarray
) -> tuple[float | None, float]:
    """How much thicker walls are than true on rays [mm], None where there is none; and the rays' share that
    meets one."""
    thickness = [_thickness(solid, start, directions) for solid in (predicted, true)]
    walls = np.isfinite(thickness[0]) & (thickness[1] <= WALL)
    excess = 1e3 * float((thickness[0] - thickness[1])[walls].mean()) if walls.any() else None
    return excess, float(walls.mean())


def _thickness(solid: Solid, start: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(N,) how far rays run within a closed solid after they first meet it [m]; infinite where they miss."""
    entry = solid.cast(start, directions)
    hit = np.isfinite(entry)
    thickness = np.full(len(directions), np.inf)
    inside = start[hit] + directions[hit] * (entry[hit, None] + BEHIND)
    thickness[hit] = solid.cast(inside, directions[hit]) + BEHIND
    return thickness
