"""Hollow and round household objects: cans, bottles, bowls, cups, mugs, plates. Standing, z up, metres."""

from __future__ import annotations

import numpy as np

from sim_scenes.objects import implicit_shapes as solid
from sim_scenes.objects import part_shapes as solid_parts
from sim_scenes.objects.paint import Shape, banded, plain, random_color


def can(rng: np.random.Generator) -> Shape:
    """A tin can with sunken lids and a label."""
    radius, height = rng.uniform(0.025, 0.052), rng.uniform(0.06, 0.16)
    lip, sink = rng.uniform(0.001, 0.003), rng.uniform(0.001, 0.004)
    inner = radius - lip - 0.003
    outline = [(0, sink), (inner, sink), (inner, 0), (radius - lip, 0), (radius, lip * 2)]
    outline += [(radius, height - lip * 2), (radius - lip, height), (inner, height), (inner, height - sink)]
    mesh = solid.revolved([*outline, (0, height - sink)])
    metal, label = random_color(rng, False), random_color(rng)
    low, high = 0.06 * height, 0.94 * height
    middle = rng.uniform(0.3, 0.6) * height
    stripe = (middle, middle + rng.uniform(0.1, 0.3) * height, random_color(rng, rng.random() < 0.5))
    core = [(0.0, sink), (inner, sink), (inner, height - sink), (0.0, height - sink)]
    parts = solid_parts.turned([core, outline[2:-1]])
    return mesh, banded(mesh, metal, (low, high, label), stripe), parts


def bottle(rng: np.random.Generator) -> Shape:
    """A bottle with waist, shoulder, neck and cap."""
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
    label = (0.2 * body, rng.uniform(0.6, 0.85) * body, random_color(rng, rng.random() < 0.5))
    colors = banded(mesh, random_color(rng), label, (top - 1e-4, 1.0, random_color(rng)))
    return mesh, colors, solid_parts.stacked(outline[1:-1])


def bowl(rng: np.random.Generator) -> Shape:
    """An open bowl."""
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
    rim = (0.85 * height, 1.0, random_color(rng, rng.random() < 0.5))
    base = [(0, 0), outer[0], inner[-1], (0, wall)]
    parts = solid_parts.turned([base]) + solid_parts.shell(outer[::3], inner[::-3])
    return mesh, banded(mesh, random_color(rng, rng.random() < 0.6), rim), parts


def cup(rng: np.random.Generator) -> Shape:
    """A beaker without a handle, hollow."""
    radius, height = rng.uniform(0.028, 0.048), rng.uniform(0.06, 0.12)
    wall, low = rng.uniform(0.0022, 0.004), radius * rng.uniform(0.65, 1.0)
    base, side = _cup_sections(radius, low, height, wall)
    mesh = solid.revolved([*base[:2], *side[1:], (low - wall - 0.002, wall), (0, wall)])
    band = rng.uniform(0.1, 0.7) * height
    stripe = (band, band + rng.uniform(0.1, 0.25) * height, random_color(rng))
    return mesh, banded(mesh, random_color(rng), stripe), solid_parts.turned([base, side])


def _cup_sections(
    radius: float, low: float, height: float, wall: float
) -> tuple[list[tuple[float, float]], list[tuple[float, float]]]:
    """Convex cross-sections (radius, z) of a cup's base and of its side; low: radius at the base."""
    base = [(0.0, 0.0), (low - 0.002, 0.0), (low - 0.002, wall), (0.0, wall)]
    rim = [(radius, height - 0.001), (radius - wall / 2, height), (radius - wall, height - 0.001)]
    return base, [(low - 0.002, 0.0), (low, 0.002), *rim, (low - wall, wall + 0.002)]


def mug(rng: np.random.Generator) -> Shape:
    """A hollow mug with a handle."""
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
        distance, [-radius, -radius, 0], [radius + reach + bar, radius, height], 0.0018, 20_000
    )
    colors = plain(mesh, random_color(rng))
    inside = np.hypot(mesh.vertices[:, 0], mesh.vertices[:, 1]) < radius - 0.6 * wall
    colors[inside & (mesh.vertices[:, 2] > 0.5 * wall)] = random_color(rng, False)
    parts = solid_parts.turned(_cup_sections(radius, radius, height, wall))
    return mesh, colors, parts + solid_parts.bars(path, bars)


def plate(rng: np.random.Generator) -> Shape:
    """A plate with a raised rim."""
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
    base, rim = random_color(rng, rng.random() < 0.5), random_color(rng, rng.random() < 0.5)
    colors = plain(mesh, base)
    colors[np.hypot(mesh.vertices[:, 0], mesh.vertices[:, 1]) > 0.88 * radius] = rim
    under = [(flat, 0.0), (knee, lift - wall), (radius, height - wall / 2)]
    above = [(flat - wall, wall), (knee - wall, lift), (radius, height)]
    disc = [(0.0, 0.0), (flat, 0.0), (flat - wall, wall), (0.0, wall)]
    return mesh, colors, solid_parts.turned([disc]) + solid_parts.shell(under, above)
