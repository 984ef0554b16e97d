"""Procedural household objects, with random dimensions and colours, as watertight meshes; z up, metres.

`make(family, rng)` draws one of a family; `families()` names them, so that a training set can use some and hold
out others. Shapes that ship with pybullet are families of their own (`shipped_shapes`).
"""

from __future__ import annotations

import colorsys
from collections.abc import Callable

import numpy as np
import trimesh

from mapping.errors import ConfigError
from sim_scenes import implicit_shapes as solid
from sim_scenes import shipped_shapes
from sim_scenes.object_model import ObjectModel

Colored = tuple[trimesh.Trimesh, np.ndarray]
"""A mesh and its (V, 3) colours in 0..1."""


def families() -> list[str]:
    """Names of all families, procedural first, then the shapes that ship with pybullet."""
    return [*PROCEDURAL, *shipped_shapes.names()]


def make(family: str, rng: np.random.Generator) -> ObjectModel:
    """One object of a family with random dimensions and colours.

    Raises ConfigError for an unknown family.
    """
    if family in PROCEDURAL:
        mesh, colors = PROCEDURAL[family](rng)
        tint = np.clip(colors * 255, 0, 255).astype(np.uint8)
        return ObjectModel(family, "builtin", mesh, vertex_colors=tint)
    if family in shipped_shapes.names():
        return shipped_shapes.load(family, rng)
    raise ConfigError(f"family: {family!r} is unknown; valid: {', '.join(families())}")


def draw(count: int, rng: np.random.Generator) -> list[ObjectModel]:
    """Objects of different families (of the same again only when there are more objects than families)."""
    names = families()
    chosen = np.concatenate([rng.permutation(len(names)) for _ in range(-(-count // len(names)))])
    return [make(names[index], rng) for index in chosen[:count]]


def _color(rng: np.random.Generator, strong: bool = True) -> np.ndarray:
    """A random paint colour, or with strong=False a pale or metallic one."""
    hue = rng.random()
    saturation, value = (
        (rng.uniform(0.45, 0.9), rng.uniform(0.45, 0.95))
        if strong
        else (rng.uniform(0, 0.12), rng.uniform(0.6, 0.92))
    )
    return np.array(colorsys.hsv_to_rgb(hue, saturation, value))


def _plain(mesh: trimesh.Trimesh, color: np.ndarray) -> np.ndarray:
    return np.tile(color, (len(mesh.vertices), 1))


def _banded(mesh: trimesh.Trimesh, base: np.ndarray, *bands: tuple[float, float, np.ndarray]) -> np.ndarray:
    """Base colour with bands of colour between two heights [m] each."""
    colors = _plain(mesh, base)
    z = mesh.vertices[:, 2]
    for low, high, color in bands:
        colors[(z >= low) & (z <= high)] = color
    return colors


def _box(rng: np.random.Generator) -> Colored:
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
    base, panel, stripe = _color(rng), _color(rng, rng.random() < 0.5), _color(rng)
    share = np.abs(mesh.vertices) / half
    inner = np.sort(share, axis=1)[:, 1] < rng.uniform(0.6, 0.85)
    colors = _plain(mesh, base)
    colors[inner] = panel
    at = rng.uniform(-0.6, 0.6)
    colors[np.abs(mesh.vertices[:, 2] / half[2] - at) < 0.1] = stripe
    return mesh, colors


def _can(rng: np.random.Generator) -> Colored:
    radius, height = rng.uniform(0.025, 0.052), rng.uniform(0.06, 0.16)
    lip, sink = rng.uniform(0.001, 0.003), rng.uniform(0.001, 0.004)
    inner = radius - lip - 0.003
    outline = [(0, sink), (inner, sink), (inner, 0), (radius - lip, 0), (radius, lip * 2)]
    outline += [(radius, height - lip * 2), (radius - lip, height), (inner, height), (inner, height - sink)]
    mesh = solid.revolved([*outline, (0, height - sink)])
    metal, label = _color(rng, False), _color(rng)
    low, high = 0.06 * height, 0.94 * height
    middle = rng.uniform(0.3, 0.6) * height
    stripe = (middle, middle + rng.uniform(0.1, 0.3) * height, _color(rng, rng.random() < 0.5))
    return mesh, _banded(mesh, metal, (low, high, label), stripe)


def _bottle(rng: np.random.Generator) -> Colored:
    radius, body = rng.uniform(0.022, 0.045), rng.uniform(0.08, 0.16)
    neck, shoulder = rng.uniform(0.008, 0.5 * radius), rng.uniform(0.015, 0.05)
    neck_length, cap = rng.uniform(0.015, 0.05), rng.uniform(0.01, 0.02)
    waist = rng.uniform(0.8, 1.0)
    shares = np.linspace(0, 1, 9)
    side = 1 - (1 - waist) * np.sin(np.pi * np.linspace(0, 1, 12)) ** 2
    outline = [(0, 0), (radius - 0.003, 0), (radius, 0.003)]
    outline += list(zip(radius * side, np.linspace(0.006, body, 12)))
    outline += list(
        zip(neck + (radius - neck) * (0.5 + 0.5 * np.cos(np.pi * shares[1:])), body + shoulder * shares[1:])
    )
    top = body + shoulder + neck_length
    wide = neck + rng.uniform(0.001, 0.005)
    outline += [
        (neck, top),
        (wide, top),
        (wide, top + cap - 0.002),
        (wide - 0.002, top + cap),
        (0, top + cap),
    ]
    mesh = solid.revolved(outline)
    label = (0.2 * body, rng.uniform(0.6, 0.85) * body, _color(rng, rng.random() < 0.5))
    return mesh, _banded(mesh, _color(rng), label, (top - 1e-4, 1.0, _color(rng)))


def _bowl(rng: np.random.Generator) -> Colored:
    radius, height = rng.uniform(0.05, 0.09), rng.uniform(0.035, 0.075)
    wall, foot = rng.uniform(0.0025, 0.005), rng.uniform(0.35, 0.6)
    power = rng.uniform(0.45, 0.8)
    shares = np.linspace(0, 1, 16)
    outer = [(radius * (foot + (1 - foot) * s**power), height * s) for s in shares]
    inner_radius = radius - wall
    inner = [
        (inner_radius * (foot + (1 - foot) * s**power), wall + (height - wall) * s) for s in shares[::-1]
    ]
    mesh = solid.revolved([(0, 0), *outer, *inner, (0, wall)])
    rim = (0.85 * height, 1.0, _color(rng, rng.random() < 0.5))
    return mesh, _banded(mesh, _color(rng, rng.random() < 0.6), rim)


def _cup_profile(radius: float, height: float, wall: float, taper: float) -> list[tuple[float, float]]:
    low = radius * taper
    return [
        (0, 0),
        (low - 0.002, 0),
        (low, 0.002),
        (radius, height - 0.001),
        (radius - wall / 2, height),
        (radius - wall, height - 0.001),
        (low - wall, wall + 0.002),
        (low - wall - 0.002, wall),
        (0, wall),
    ]


def _cup(rng: np.random.Generator) -> Colored:
    radius, height = rng.uniform(0.028, 0.048), rng.uniform(0.06, 0.12)
    mesh = solid.revolved(_cup_profile(radius, height, rng.uniform(0.0022, 0.004), rng.uniform(0.65, 1.0)))
    band = rng.uniform(0.1, 0.7) * height
    return mesh, _banded(mesh, _color(rng), (band, band + rng.uniform(0.1, 0.25) * height, _color(rng)))


def _mug(rng: np.random.Generator) -> Colored:
    radius, height = rng.uniform(0.034, 0.048), rng.uniform(0.075, 0.115)
    wall, bar = rng.uniform(0.003, 0.005), rng.uniform(0.004, 0.007)
    reach, half = rng.uniform(0.020, 0.034), rng.uniform(0.26, 0.36) * height
    angle = np.linspace(-np.pi / 2, np.pi / 2, 14)
    bend = rng.uniform(0.6, 1.0)
    x = radius - wall / 2 + reach * np.cos(angle) ** bend
    path = np.stack([x, np.zeros(14), height * 0.5 + half * np.sin(angle)], axis=1)
    bars = np.full(14, bar)

    def distance(points: np.ndarray) -> np.ndarray:
        outside = solid.cylinder(points, radius, 0, height)
        shape = solid.smooth_union(outside, solid.tube(points, path, bars), 0.006)
        return np.maximum(shape, -solid.cylinder(points, radius - wall, wall, height + 0.05))

    mesh = solid.mesh_of(
        distance, [-radius, -radius, 0], [radius + reach + bar, radius, height], faces=16_000
    )
    colors = _plain(mesh, _color(rng))
    inside = np.hypot(mesh.vertices[:, 0], mesh.vertices[:, 1]) < radius - 0.6 * wall
    colors[inside & (mesh.vertices[:, 2] > 0.5 * wall)] = _color(rng, False)
    return mesh, colors


def _plate(rng: np.random.Generator) -> Colored:
    radius, height, wall = rng.uniform(0.07, 0.12), rng.uniform(0.012, 0.026), rng.uniform(0.003, 0.005)
    flat = rng.uniform(0.5, 0.7) * radius
    lift = rng.uniform(0.4, 0.9) * height
    knee = flat + 0.012
    mesh = solid.revolved(
        [
            (0, 0),
            (flat, 0),
            (knee, lift - wall),
            (radius, height - wall / 2),
            (radius, height),
            (knee - wall, lift),
            (flat - wall, wall),
            (0, wall),
        ],
        sections=96,
    )
    base, rim = _color(rng, rng.random() < 0.5), _color(rng, rng.random() < 0.5)
    colors = _plain(mesh, base)
    colors[np.hypot(mesh.vertices[:, 0], mesh.vertices[:, 1]) > 0.88 * radius] = rim
    return mesh, colors


def _ball(rng: np.random.Generator) -> Colored:
    radius = rng.uniform(0.02, 0.055)
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=radius)
    axis = rng.normal(size=3)
    along = mesh.vertices @ (axis / np.linalg.norm(axis)) / radius
    colors = _plain(mesh, _color(rng))
    colors[np.abs(along) < rng.uniform(0.0, 0.3)] = _color(rng, rng.random() < 0.5)
    return mesh, colors


def _fruit(rng: np.random.Generator) -> Colored:
    radius, tall = rng.uniform(0.025, 0.042), rng.uniform(0.8, 1.35)
    dent, pear = rng.uniform(0, 0.25), rng.uniform(-0.25, 0.25)
    angle = np.linspace(-np.pi / 2, np.pi / 2, 40)
    r = radius * np.cos(angle) * (1 - pear * np.sin(angle))
    z = radius * tall * np.sin(angle) * (1 - dent * np.exp(-((r / radius / 0.35) ** 2)))
    mesh = solid.revolved(list(zip(r, z - z.min())))
    shade = (mesh.vertices[:, 2:] / np.ptp(mesh.vertices[:, 2])) ** 1.5
    return mesh, _color(rng) * (1 - shade) + _color(rng) * shade


def _banana(rng: np.random.Generator) -> Colored:
    length, thick, sweep = rng.uniform(0.13, 0.19), rng.uniform(0.014, 0.02), rng.uniform(0.7, 1.6)
    angle = np.linspace(-sweep / 2, sweep / 2, 16)
    arc = length / sweep
    path = np.stack(
        [arc * np.sin(angle), arc * (np.cos(angle) - np.cos(sweep / 2)), 0 * angle + thick], axis=1
    )
    taper = thick * np.maximum(1 - np.abs(np.linspace(-1, 1, 16)) ** 3 * 0.75, 0.2)
    low, high = path.min(axis=0) - thick, path.max(axis=0) + thick
    mesh = solid.mesh_of(lambda points: solid.tube(points, path, taper), low, high, 0.0015, 6000)
    colors = _plain(mesh, np.array([0.93, 0.78, 0.16]) * rng.uniform(0.8, 1.05))
    colors[np.abs(mesh.vertices[:, 0]) > 0.95 * np.abs(mesh.vertices[:, 0]).max()] = [0.3, 0.24, 0.1]
    return mesh, colors


def _screwdriver(rng: np.random.Generator) -> Colored:
    grip, grip_length = rng.uniform(0.010, 0.018), rng.uniform(0.07, 0.11)
    shaft, shaft_length = rng.uniform(0.0025, 0.005), rng.uniform(0.06, 0.14)
    shares = np.linspace(0, 1, 14)
    swell = grip * (0.82 + 0.18 * np.cos(2 * np.pi * shares * rng.integers(1, 3)))
    outline = [(0, 0), (0.7 * grip, 0), *zip(swell, 0.004 + (grip_length - 0.004) * shares)]
    tip = grip_length + shaft_length
    outline += [(shaft * 1.6, grip_length + 0.004), (shaft, grip_length + 0.008), (shaft, tip - 0.006)]
    mesh = solid.revolved([*outline, (0.5 * shaft, tip), (0, tip)], sections=48)
    colors = _banded(mesh, _color(rng), (grip_length + 0.003, 1.0, _color(rng, False)))
    return _lay_down(mesh), colors


def _hammer(rng: np.random.Generator) -> Colored:
    length, grip, head = rng.uniform(0.17, 0.25), rng.uniform(0.009, 0.013), rng.uniform(0.07, 0.11)
    half = rng.uniform(0.010, 0.016)
    path = np.array([[0, 0, half], [0.6 * length, 0, half], [length, 0, half]])
    radii = np.array([grip, 0.8 * grip, 0.8 * grip])

    def distance(points: np.ndarray) -> np.ndarray:
        block = solid.box(points, [length, 0, half], [half, head / 2, half], rng_round)
        return np.minimum(block, solid.tube(points, path, radii))

    rng_round = rng.uniform(0.001, 0.006)
    mesh = solid.mesh_of(
        distance, [-grip, -head / 2, min(0, half - grip)], [length + half, head / 2, 2 * half + grip], 0.0015
    )
    colors = _plain(mesh, _color(rng))
    colors[mesh.vertices[:, 0] > length - half - 0.002] = _color(rng, False) * 0.6
    return mesh, colors


def _wrench(rng: np.random.Generator) -> Colored:
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
    mesh = solid.mesh_of(distance, low, high, 0.001)
    return mesh, _plain(mesh, _color(rng, False) * rng.uniform(0.45, 0.85))


def _spoon(rng: np.random.Generator) -> Colored:
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
    mesh = solid.mesh_of(distance, low, high, 0.001)
    colors = _plain(mesh, _color(rng, rng.random() < 0.5))
    colors[mesh.vertices[:, 0] > rng.uniform(1.2, 3.0) * bowl] = _color(rng)
    return mesh, colors


def _spatula(rng: np.random.Generator) -> Colored:
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
    mesh = solid.mesh_of(distance, low, high, 0.001, 14_000)
    colors = _plain(mesh, _color(rng, rng.random() < 0.3) * 0.8)
    colors[mesh.vertices[:, 0] > blade + 0.4 * length] = _color(rng)
    return mesh, colors


def _blocks(rng: np.random.Generator) -> Colored:
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
    return mesh, np.array([_color(rng) for _ in placed])[nearest]


def _ring(rng: np.random.Generator) -> Colored:
    major, minor = rng.uniform(0.025, 0.06), rng.uniform(0.006, 0.016)
    mesh = trimesh.creation.torus(major, minor, major_sections=80, minor_sections=28)
    return mesh, _plain(mesh, _color(rng))


def _lay_down(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Turn a tool made along z so that it lies along x."""
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [0, 1, 0]))
    return mesh


PROCEDURAL: dict[str, Callable[[np.random.Generator], Colored]] = {
    "box": _box,
    "can": _can,
    "bottle": _bottle,
    "bowl": _bowl,
    "cup": _cup,
    "mug": _mug,
    "plate": _plate,
    "ball": _ball,
    "fruit": _fruit,
    "banana": _banana,
    "screwdriver": _screwdriver,
    "hammer": _hammer,
    "wrench": _wrench,
    "spoon": _spoon,
    "spatula": _spatula,
    "blocks": _blocks,
    "ring": _ring,
}
"""Family name -> maker."""
