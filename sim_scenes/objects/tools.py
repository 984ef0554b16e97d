"""Long and thin household objects: tools and cutlery. Lying along x, z up, metres."""

from __future__ import annotations

import numpy as np
import trimesh

from sim_scenes.objects import implicit_shapes as solid
from sim_scenes.objects import part_shapes as solid_parts
from sim_scenes.objects.paint import Shape, banded, plain, random_color

LYING = trimesh.transformations.rotation_matrix(np.pi / 2, [0, 1, 0])
"""Turns a tool made along z so that it lies along x."""


def screwdriver(rng: np.random.Generator) -> Shape:
    """A swelling grip with a thin shaft."""
    grip, grip_length = rng.uniform(0.010, 0.018), rng.uniform(0.07, 0.11)
    shaft, shaft_length = rng.uniform(0.0025, 0.005), rng.uniform(0.06, 0.14)
    shares = np.linspace(0, 1, 14)
    swell = grip * (0.82 + 0.18 * np.cos(2 * np.pi * shares * rng.integers(1, 3)))
    outline = [(0, 0), (0.7 * grip, 0), *zip(swell, 0.004 + (grip_length - 0.004) * shares)]
    tip = grip_length + shaft_length
    outline += [(shaft * 1.6, grip_length + 0.004), (shaft, grip_length + 0.008), (shaft, tip - 0.006)]
    outline += [(0.5 * shaft, tip), (0, tip)]
    mesh = solid.revolved(outline, sections=48)
    colors = banded(mesh, random_color(rng), (grip_length + 0.003, 1.0, random_color(rng, False)))
    mesh.apply_transform(LYING)
    return mesh, colors, [part @ LYING[:3, :3].T for part in solid_parts.stacked(outline[1:-1])]


def hammer(rng: np.random.Generator) -> Shape:
    """A round handle through a block."""
    length, grip, head = rng.uniform(0.17, 0.25), rng.uniform(0.009, 0.013), rng.uniform(0.07, 0.11)
    half = rng.uniform(0.010, 0.016)
    path = np.array([[0, 0, half], [0.6 * length, 0, half], [length, 0, half]])
    radii = np.array([grip, 0.8 * grip, 0.8 * grip])

    def distance(points: np.ndarray) -> np.ndarray:
        block = solid.box(points, [length, 0, half], [half, head / 2, half], rounding)
        return np.minimum(block, solid.tube(points, path, radii))

    rounding = rng.uniform(0.001, 0.006)
    mesh = solid.mesh_of(
        distance, [-grip, -head / 2, min(0, half - grip)], [length + half, head / 2, 2 * half + grip], 0.0015
    )
    colors = plain(mesh, random_color(rng))
    colors[mesh.vertices[:, 0] > length - half - 0.002] = random_color(rng, False) * 0.6
    head_block = solid_parts.block([length, 0, half], [half, head / 2, half], rounding)
    return mesh, colors, [head_block, *solid_parts.bars(path, radii)]


def wrench(rng: np.random.Generator) -> Shape:
    """A flat spanner: an open jaw at one end, a ring at the other."""
    length, width, half = rng.uniform(0.13, 0.21), rng.uniform(0.006, 0.010), rng.uniform(0.003, 0.006)
    head, gap = rng.uniform(0.015, 0.023), rng.uniform(0.35, 0.55)
    turn = rng.uniform(-0.4, 0.4)

    def disc(points: np.ndarray, x: float, radius: float) -> np.ndarray:
        return solid.cylinder(points - np.array([x, 0, 0], np.float32), radius, 0, 2 * half)

    def distance(points: np.ndarray) -> np.ndarray:
        bar = solid.box(points, [length / 2, 0, half], [length / 2, width, half * 0.8], 0.001)
        shape = solid.smooth_union(bar, disc(points, 0, head), 0.006)
        shape = solid.smooth_union(shape, disc(points, length, 0.75 * head), 0.006)
        shape = np.maximum(shape, np.abs(points[..., 2] - half) - half)
        shape = np.maximum(shape, -disc(points, length, 0.4 * head))
        x = points[..., 0] * np.cos(turn) + points[..., 1] * np.sin(turn)
        y = points[..., 1] * np.cos(turn) - points[..., 0] * np.sin(turn)
        jaw = np.maximum(np.abs(y) - gap * head, x - 0.2 * head)
        return np.maximum(shape, -jaw)

    low, high = [-head, -head, 0], [length + head, head, 2 * half]
    mesh = solid.mesh_of(distance, low, high, 0.0012)
    eye = [(0.4 * head, 0), (0.75 * head, 0), (0.75 * head, 2 * half), (0.4 * head, 2 * half)]
    parts = [part + np.array([length, 0, 0]) for part in solid_parts.turned([eye])]
    caps = [(0.0, 0.2), (np.pi / 2, gap), (-np.pi / 2, gap)]  # behind the jaw's slot and on its two sides
    parts += [_cap(head, turn + side, at * head, 2 * half) for side, at in caps]
    parts.append(solid_parts.block([length / 2, 0, half], [length / 2 - 0.6 * head, width, half * 0.8]))
    return mesh, plain(mesh, random_color(rng, False) * rng.uniform(0.45, 0.85)), parts


def _cap(radius: float, direction: float, offset: float, height: float) -> np.ndarray:
    """Points of the part of a disc beyond `offset` [m] from its centre towards `direction` [rad]."""
    half_angle = np.arccos(offset / radius)
    angles = direction + np.linspace(-half_angle, half_angle, 16)
    rim = radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return np.concatenate([np.insert(rim, 2, z, axis=1) for z in (0.0, height)])


def spoon(rng: np.random.Generator) -> Shape:
    """A hollow spoon with a bent handle."""
    bowl, width, deep = rng.uniform(0.022, 0.036), rng.uniform(0.016, 0.025), rng.uniform(0.008, 0.014)
    length, bar = rng.uniform(0.10, 0.18), rng.uniform(0.0025, 0.005)
    wall = rng.uniform(0.0025, 0.0035)
    rise = rng.uniform(0.004, 0.018)
    path = np.array(
        [[0.9 * bowl, 0, deep - bar], [0.5 * length, 0, deep + rise], [length, 0, deep + 0.5 * rise]]
    )
    radii = np.array([bar, 0.9 * bar, 1.5 * bar])

    def distance(points: np.ndarray) -> np.ndarray:
        shell = solid.ellipsoid(points, [0, 0, deep], [bowl, width, deep])
        hollow = solid.ellipsoid(points, [0, 0, deep + 0.001], [bowl - wall, width - wall, deep - wall])
        shell = np.maximum(shell, points[..., 2] - deep)
        shape = np.minimum(shell, solid.tube(points, path, radii))
        return np.maximum(shape, -hollow)

    low, high = [-bowl, -width, 0], [length + 2 * bar, width, deep + rise + 2 * bar]
    mesh = solid.mesh_of(distance, low, high, 0.0012)
    colors = plain(mesh, random_color(rng, rng.random() < 0.5))
    colors[mesh.vertices[:, 0] > rng.uniform(1.2, 3.0) * bowl] = random_color(rng)
    angles = np.linspace(0.1, np.pi / 2, 5)
    outer = list(zip(width * np.sin(angles), deep - deep * np.cos(angles)))
    inner = list(zip((width - wall) * np.sin(angles), deep - (deep - wall) * np.cos(angles)))
    base = [(0.0, outer[0][1]), outer[0], inner[0], (0.0, inner[0][1])]
    parts = solid_parts.turned([base]) + solid_parts.shell(outer, inner)
    parts = [part * [bowl / width, 1, 1] for part in parts]
    return mesh, colors, parts + solid_parts.bars(path, radii)


def spatula(rng: np.random.Generator) -> Shape:
    """A slotted blade with a raised handle."""
    blade, width, half = rng.uniform(0.03, 0.05), rng.uniform(0.022, 0.042), rng.uniform(0.0018, 0.003)
    length, bar, rise = rng.uniform(0.14, 0.22), rng.uniform(0.005, 0.009), rng.uniform(0.0, 0.03)
    path = np.array(
        [[blade * 0.8, 0, half], [blade + 0.03, 0, half + rise], [blade + length, 0, half + rise]]
    )
    radii = np.array([0.4 * bar, 0.7 * bar, bar])
    slots = int(rng.integers(0, 4))

    def distance(points: np.ndarray) -> np.ndarray:
        shape = solid.box(points, [0, 0, half], [blade, width, half], 0.001)
        for slot in range(slots):
            y = width * (2 * (slot + 1) / (slots + 1) - 1)
            shape = np.maximum(shape, -solid.box(points, [0, y, half], [0.6 * blade, 0.003, 0.02], 0.001))
        return np.minimum(shape, solid.tube(points, path, radii))

    low, high = [-blade, -width, min(0, half + rise - bar)], [blade + length + bar, width, half + rise + bar]
    mesh = solid.mesh_of(distance, low, high, 0.0014, 16_000)
    colors = plain(mesh, random_color(rng, rng.random() < 0.3) * 0.8)
    colors[mesh.vertices[:, 0] > blade + 0.4 * length] = random_color(rng)
    flat = solid_parts.block([0, 0, half], [blade, width, half], 0.001)
    return mesh, colors, [flat, *solid_parts.bars(path, radii)]
