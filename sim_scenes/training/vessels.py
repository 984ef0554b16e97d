"""Random vessels for the occlusion prior, cans to pans. Each is a list of watertight parts, z up."""

from __future__ import annotations

import numpy as np
import trimesh

from sim_scenes.training.mesh_blocks import box, swept, turned

Parts = list[trimesh.Trimesh]


def can(rng: np.random.Generator) -> Parts:
    radius, height = rng.uniform(0.02, 0.06), rng.uniform(0.03, 0.2)
    rim = rng.uniform(0, 0.004)
    outline = [(radius, 0), (radius, height), (radius - 0.003, height), (radius - 0.003, height - rim)]
    return [turned(outline, 1.0 if rng.random() < 0.8 else rng.uniform(0.5, 1))]


def cone(rng: np.random.Generator) -> Parts:
    low, high = rng.uniform(0.02, 0.06), rng.uniform(0.002, 0.06)
    return [turned([(low, 0), (high, rng.uniform(0.04, 0.18))])]


def bottle(rng: np.random.Generator) -> Parts:
    radius, height = rng.uniform(0.02, 0.05), rng.uniform(0.09, 0.22)
    neck, shoulder = rng.uniform(0.2, 0.6) * radius, rng.uniform(0.5, 0.85)
    waist = radius * rng.uniform(0.75, 1.05)
    outline = [
        (0.9 * radius, 0),
        (radius, 0.04 * height),
        (waist, 0.5 * shoulder * height),
        (radius, shoulder * height),
        (neck, (shoulder + rng.uniform(0.03, 0.5) * (1 - shoulder)) * height),
        (neck, height),
    ]
    return [turned(outline, rng.uniform(0.45, 1.0))]


def spray_bottle(rng: np.random.Generator) -> Parts:
    body = bottle(rng)
    top = body[0].bounds[1, 2]
    length, thick = rng.uniform(0.04, 0.1), rng.uniform(0.012, 0.03)
    head = box([length, thick, rng.uniform(0.02, 0.04)], [rng.uniform(-0.2, 0.4) * length, 0, top])
    trigger = box([0.01, 0.012, rng.uniform(0.03, 0.06)], [rng.uniform(0.02, 0.04), 0, top - 0.03])
    return [*body, head, trigger]


def wall(radius: np.ndarray, height: np.ndarray, thickness: float, floor: float) -> list[tuple[float, float]]:
    """Profile of a vessel: up the outside (rows of radius and height), over the rim, down to the floor."""
    outside = list(zip(radius, height))
    inner = np.maximum(radius - thickness, 1e-3)
    inside = [(r, max(h, floor)) for r, h in zip(inner[::-1], height[::-1]) if h > 0]
    return [*outside, *inside, (inside[-1][0] * 0.9, floor)]


def _thickness(rng: np.random.Generator, least: float, most: float) -> float:
    """A wall's thickness [m], thin ones as likely as thick ones."""
    return float(np.exp(rng.uniform(np.log(least), np.log(most))))


def _footed(
    rng: np.random.Generator, widths: np.ndarray, heights: np.ndarray, thickness: float, floor: float
) -> trimesh.Trimesh:
    """A vessel whose floor, more often than not, is raised by a ring to stand on."""
    lift = rng.uniform(0.001, 0.25 * heights[-1]) if rng.random() < 0.6 else 0.0
    outline = wall(widths, heights, thickness, lift + floor)
    if lift:
        inner = widths[0] - np.clip(thickness, 0.002, 0.5 * widths[0])
        outline = [(inner, lift), (inner, 0.0), *outline]
    return turned(outline)


def cup(rng: np.random.Generator) -> Parts:
    low, top, height = rng.uniform(0.018, 0.04), rng.uniform(0.025, 0.05), rng.uniform(0.03, 0.13)
    share = np.linspace(0, 1, 5)
    radius = low + (top - low) * share + rng.uniform(0, 0.008) * np.sin(np.pi * share)
    return [
        turned(wall(radius, height * share, _thickness(rng, 0.0012, 0.006), _thickness(rng, 0.0015, 0.008)))
    ]


def _handle(reach: float, low: float, high: float, at: float, radii: tuple[float, float]) -> trimesh.Trimesh:
    angle = np.linspace(-np.pi / 2, np.pi / 2, 11)
    path = np.stack(
        [at + reach * np.cos(angle), 0 * angle, (low + high) / 2 + (high - low) / 2 * np.sin(angle)], axis=1
    )
    return swept(path, np.tile(radii, (11, 1)))


def mug(rng: np.random.Generator) -> Parts:
    vessel = cup(rng)
    height, radius = vessel[0].bounds[1, 2], vessel[0].bounds[1, 0]
    wire = (rng.uniform(0.003, 0.008), rng.uniform(0.002, 0.006))
    reach = rng.uniform(0.015, 0.04)
    return [*vessel, _handle(reach, rng.uniform(0.1, 0.3) * height, 0.85 * height, 0.93 * radius, wire)]


def pitcher(rng: np.random.Generator) -> Parts:
    radius, height = rng.uniform(0.04, 0.08), rng.uniform(0.14, 0.26)
    share = np.linspace(0, 1, 6)
    widths = radius * (1 + rng.uniform(-0.15, 0.15) * share + rng.uniform(-0.1, 0.1) * np.sin(np.pi * share))
    body = turned(wall(widths, height * share, rng.uniform(0.002, 0.005), rng.uniform(0.003, 0.01)))
    wire = (rng.uniform(0.006, 0.014), rng.uniform(0.005, 0.01))
    handle = _handle(rng.uniform(0.03, 0.06), 0.15 * height, 0.9 * height, 0.95 * radius, wire)
    return [body, handle]


def pot(rng: np.random.Generator) -> Parts:
    """A cooking or flower pot: wide, sometimes with two handles."""
    radius, height = rng.uniform(0.05, 0.13), rng.uniform(0.06, 0.18)
    share = np.linspace(0, 1, 5)
    foot = rng.uniform(0.65, 1.05)
    widths = radius * (foot + (1 - foot) * share + rng.uniform(-0.05, 0.12) * np.sin(np.pi * share))
    body = _footed(rng, widths, height * share, _thickness(rng, 0.0012, 0.006), _thickness(rng, 0.002, 0.01))
    if rng.random() < 0.5:
        return [body]
    wire = (rng.uniform(0.003, 0.008), rng.uniform(0.003, 0.006))
    reach, low = rng.uniform(0.012, 0.03), rng.uniform(0.6, 0.75) * height
    one = _handle(reach, low, 0.92 * height, 0.94 * widths[-1], wire)
    other = one.copy()
    other.apply_transform(np.diag([-1.0, -1.0, 1.0, 1.0]))
    return [body, one, other]


def basket(rng: np.random.Generator) -> Parts:
    """An open vessel with four rounded corners: baskets, bins, square bowls, baking dishes, square plates."""
    radius, height = rng.uniform(0.04, 0.15), float(np.exp(rng.uniform(np.log(0.012), np.log(0.16))))
    share = np.linspace(0, 1, 4)
    foot = rng.uniform(0.6, 1.0)
    widths = radius * (foot + (1 - foot) * share)
    outline = wall(widths, height * share, _thickness(rng, 0.0012, 0.007), _thickness(rng, 0.0012, 0.007))
    return [turned(outline, rng.uniform(0.5, 1.0), rng.uniform(0.15, 0.6))]


def bowl(rng: np.random.Generator) -> Parts:
    radius, height = rng.uniform(0.05, 0.11), rng.uniform(0.03, 0.08)
    share = np.linspace(0, 1, 8)
    foot = rng.uniform(0.2, 0.6)
    widths = radius * (foot + (1 - foot) * share ** rng.uniform(0.4, 0.9))
    thickness, floor = _thickness(rng, 0.0012, 0.006), _thickness(rng, 0.0012, 0.006)
    return [_footed(rng, widths, height * share, thickness, floor)]


def dish(rng: np.random.Generator) -> Parts:
    radius, height = rng.uniform(0.07, 0.14), rng.uniform(0.012, 0.035)
    base = rng.uniform(0.4, 0.8) * radius
    widths = np.array([base, base * 1.05, radius])
    heights = np.array([0.0, 0.15 * height, height])
    return [_footed(rng, widths, heights, _thickness(rng, 0.002, 0.016), _thickness(rng, 0.001, 0.006))]


def pan(rng: np.random.Generator) -> Parts:
    radius, height = rng.uniform(0.06, 0.13), rng.uniform(0.02, 0.06)
    widths = radius * np.array([0.85, 1.0])
    body = turned(wall(widths, np.array([0, height]), rng.uniform(0.002, 0.005), 0.004))
    length = rng.uniform(0.1, 0.18)
    handle = box(
        [length, rng.uniform(0.015, 0.03), rng.uniform(0.006, 0.02)],
        [radius + 0.45 * length, 0, 0.8 * height],
    )
    return [body, handle]


def lid(rng: np.random.Generator) -> Parts:
    radius, rise = rng.uniform(0.05, 0.13), rng.uniform(0.005, 0.04)
    share = np.linspace(1, 0, 6)
    upper = [(radius * s, rise * (1 - s**2) + 0.004) for s in share]
    lower = [(radius * s, rise * (1 - s**2)) for s in share[::-1]]
    knob = rng.uniform(0.008, 0.02)
    dome = turned([*lower[1:], (radius, 0.0), *upper[:-1]])
    stem = turned([(0.5 * knob, rise), (knob, rise + 1.2 * knob), (knob, rise + 1.6 * knob)])
    return [dome, stem]


def goblet(rng: np.random.Generator) -> Parts:
    vessel = cup(rng)
    stem, foot = rng.uniform(0.03, 0.08), rng.uniform(0.02, 0.04)
    vessel[0].apply_translation([0, 0, stem])
    return [*vessel, turned([(foot, 0), (foot, 0.003), (0.005, 0.008), (0.005, stem + 0.002)])]
