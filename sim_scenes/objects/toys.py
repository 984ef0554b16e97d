"""Compact household objects: boxes, balls, fruit, bricks, rings. z up, metres."""

from __future__ import annotations

import numpy as np
import trimesh

from sim_scenes.objects import implicit_shapes as solid
from sim_scenes.objects import part_shapes as solid_parts
from sim_scenes.objects.paint import Shape, plain, random_color


def box(rng: np.random.Generator) -> Shape:
    """A carton with rounded edges and a printed panel."""
    kind = rng.choice(["carton", "flat", "brick"])
    low, high = {
        "carton": ([0.04, 0.08, 0.12], [0.08, 0.17, 0.23]),
        "flat": ([0.06, 0.08, 0.02], [0.11, 0.16, 0.05]),
        "brick": ([0.04, 0.04, 0.04], [0.09, 0.12, 0.12]),
    }[str(kind)]
    half = rng.uniform(low, high) / 2
    rounding = rng.uniform(0.001, 0.005)
    corner = trimesh.creation.icosphere(subdivisions=2, radius=rounding).vertices
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T
    mesh = trimesh.convex.convex_hull((signs[:, None] * (half - rounding) + corner).reshape(-1, 3))
    mesh = mesh.subdivide_to_size(0.006)
    mesh.merge_vertices()
    # A printed panel on every side and a stripe around, as on a packet.
    base, panel, stripe = random_color(rng), random_color(rng, rng.random() < 0.5), random_color(rng)
    share = np.abs(mesh.vertices) / half
    inner = np.sort(share, axis=1)[:, 1] < rng.uniform(0.6, 0.85)
    colors = plain(mesh, base)
    colors[inner] = panel
    at = rng.uniform(-0.6, 0.6)
    colors[np.abs(mesh.vertices[:, 2] / half[2] - at) < 0.1] = stripe
    return mesh, colors, [mesh.vertices]


def ball(rng: np.random.Generator) -> Shape:
    """A ball with a stripe."""
    radius = rng.uniform(0.02, 0.055)
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=radius)
    axis = rng.normal(size=3)
    along = mesh.vertices @ (axis / np.linalg.norm(axis)) / radius
    colors = plain(mesh, random_color(rng))
    colors[np.abs(along) < rng.uniform(0.0, 0.3)] = random_color(rng, rng.random() < 0.5)
    return mesh, colors, [mesh.vertices]


def fruit(rng: np.random.Generator) -> Shape:
    """A round fruit, dented at the poles or drawn out like a pear."""
    radius, tall = rng.uniform(0.025, 0.042), rng.uniform(0.8, 1.35)
    dent, pear = rng.uniform(0, 0.25), rng.uniform(-0.25, 0.25)
    angle = np.linspace(-np.pi / 2, np.pi / 2, 40)
    r = radius * np.cos(angle) * (1 - pear * np.sin(angle))
    z = radius * tall * np.sin(angle) * (1 - dent * np.exp(-((r / radius / 0.35) ** 2)))
    mesh = solid.revolved(list(zip(r, z - z.min())))
    shade = (mesh.vertices[:, 2:] / np.ptp(mesh.vertices[:, 2])) ** 1.5
    return mesh, random_color(rng) * (1 - shade) + random_color(rng) * shade, [mesh.vertices]


def banana(rng: np.random.Generator) -> Shape:
    """A bent bar with pointed ends."""
    length, thick, sweep = rng.uniform(0.13, 0.19), rng.uniform(0.014, 0.02), rng.uniform(0.7, 1.6)
    angle = np.linspace(-sweep / 2, sweep / 2, 16)
    arc = length / sweep
    path = np.stack(
        [arc * np.sin(angle), arc * (np.cos(angle) - np.cos(sweep / 2)), 0 * angle + thick], axis=1
    )
    taper = thick * np.maximum(1 - np.abs(np.linspace(-1, 1, 16)) ** 3 * 0.75, 0.2)
    low, high = path.min(axis=0) - thick, path.max(axis=0) + thick
    mesh = solid.mesh_of(lambda points: solid.tube(points, path, taper), low, high, 0.0015, 6000)
    colors = plain(mesh, np.array([0.93, 0.78, 0.16]) * rng.uniform(0.8, 1.05))
    colors[np.abs(mesh.vertices[:, 0]) > 0.95 * np.abs(mesh.vertices[:, 0]).max()] = [0.3, 0.24, 0.1]
    return mesh, colors, solid_parts.bars(path, taper)


def blocks(rng: np.random.Generator) -> Shape:
    """Two or three bricks joined: L, T and stair shapes, as toy bricks make."""
    unit = rng.uniform(0.012, 0.02)
    placed = [(np.zeros(3), rng.integers(1, 4, 3) * unit)]
    for _ in range(int(rng.integers(1, 3))):
        center, half = placed[int(rng.integers(len(placed)))]
        size = rng.integers(1, 3, 3) * unit
        axis = int(rng.integers(3))
        step = (rng.random(3) - 0.5) * half
        step[axis] = (half[axis] + size[axis] - 0.002) * rng.choice([-1, 1])
        placed.append((center + step, size))
    rounding = rng.uniform(0.0015, 0.004)

    def distance(points: np.ndarray) -> np.ndarray:
        return np.min([solid.box(points, center, half, rounding) for center, half in placed], axis=0)

    low = np.min([center - half for center, half in placed], axis=0)
    high = np.max([center + half for center, half in placed], axis=0)
    mesh = solid.mesh_of(distance, low, high, 0.0015)
    nearest = np.argmin([solid.box(mesh.vertices, center, half, rounding) for center, half in placed], axis=0)
    colors = np.array([random_color(rng) for _ in placed])[nearest]
    return mesh, colors, [solid_parts.block(center, half, rounding) for center, half in placed]


def ring(rng: np.random.Generator) -> Shape:
    """A torus."""
    major, minor = rng.uniform(0.025, 0.06), rng.uniform(0.006, 0.016)
    mesh = trimesh.creation.torus(major, minor, major_sections=80, minor_sections=28)
    angles = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    section = list(zip(major + minor * np.cos(angles), minor * np.sin(angles)))
    return mesh, plain(mesh, random_color(rng)), solid_parts.turned([section])
