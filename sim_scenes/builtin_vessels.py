"""Hollow and round household objects: cans, bottles, bowls, cups, mugs, plates. Standing, z up, metres."""

from __future__ import annotations

import numpy as np

from sim_scenes import implicit_shapes as solid
from sim_scenes.paint import Colored, banded, plain, random_color


def can(rng: np.random.Generator) -> Colored:
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
    return mesh, banded(mesh, metal, (low, high, label), stripe)


def bottle(rng: np.random.Generator) -> Colored:
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
    return mesh, banded(mesh, random_color(rng), label, (top - 1e-4, 1.0, random_color(rng)))


def bowl(rng: np.random.Generator) -> Colored:
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
    return mesh, banded(mesh, random_color(rng, rng.random() < 0.6), rim)


def cup(rng: np.random.Generator) -> Colored:
    """A beaker without a handle, hollow."""
    radius, height = rng.uniform(0.028, 0.048), rng.uniform(0.06, 0.12)
    mesh = solid.revolved(_cup_profile(radius, height, rng.uniform(0.0022, 0.004), rng.uniform(0.65, 1.0)))
    band = rng.uniform(0.1, 0.7) * height
    return mesh, banded(
        mesh, random_color(rng), (band, band + rng.uniform(0.1, 0.25) * height, random_color(rng))
    )


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


def mug(rng: np.random.Generator) -> Colored:
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
        distance, [-radius, -radius, 0], [radius + reach + bar, radius, height], faces=16_000
    )
    colors = plain(mesh, random_color(rng))
    inside = np.hypot(mesh.vertices[:, 0], mesh.vertices[:, 1]) < radius - 0.6 * wall
    colors[inside & (mesh.vertices[:, 2] > 0.5 * wall)] = random_color(rng, False)
    return mesh, colors


def plate(rng: np.random.Generator) -> Colored:
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
    return mesh, colors
