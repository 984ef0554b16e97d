"""Random boxes, balls, fruit and toys for the occlusion prior. Each a list of watertight parts, z up."""

from __future__ import annotations

import numpy as np
import trimesh

from sim_scenes.training.mesh_blocks import box, plate, rounded, swept, turned

Parts = list[trimesh.Trimesh]


def block(rng: np.random.Generator) -> Parts:
    size = np.exp(rng.uniform(np.log(0.03), np.log(0.22), 3))
    return [box(size)] if rng.random() < 0.7 else [rounded(size / 2, rng.uniform(0.1, 0.4))]


def flat_box(rng: np.random.Generator) -> Parts:
    return [box([rng.uniform(0.06, 0.24), rng.uniform(0.05, 0.18), rng.uniform(0.01, 0.05)])]


def packet(rng: np.random.Generator) -> Parts:
    """A standing box such as food is sold in."""
    low, high = np.log([0.05, 0.02, 0.07]), np.log([0.22, 0.10, 0.28])
    return [box(np.exp(rng.uniform(low, high)))]


def ball(rng: np.random.Generator) -> Parts:
    radius = np.exp(rng.uniform(np.log(0.012), np.log(0.09)))
    return [rounded([radius] * 3, 1.0)]


def ellipsoid(rng: np.random.Generator) -> Parts:
    return [rounded(rng.uniform(0.015, 0.08, 3), rng.uniform(0.7, 1.2))]


def fruit(rng: np.random.Generator) -> Parts:
    radius, squash = rng.uniform(0.025, 0.06), rng.uniform(0.8, 1.4)
    angle = np.linspace(-np.pi / 2, np.pi / 2, 15)
    width = radius * np.cos(angle) * (1 + rng.uniform(0, 0.3) * np.sin(angle))
    dent = rng.uniform(0, 0.35) * radius * np.exp(-((width / (0.35 * radius)) ** 2))
    return [turned(np.stack([width, squash * (radius * np.sin(angle) - np.sign(angle) * dent)], axis=1))]


def banana(rng: np.random.Generator) -> Parts:
    bend, length = rng.uniform(0.3, 1.6), rng.uniform(0.12, 0.22)
    angle = np.linspace(-bend / 2, bend / 2, 15)
    path = length / bend * np.stack([np.sin(angle), np.cos(angle), 0 * angle], axis=1)
    share = np.linspace(-1, 1, 15)
    thick = rng.uniform(0.014, 0.022) * np.maximum(1 - np.abs(share) ** rng.uniform(2, 4), 0.18)
    return [swept(path, np.stack([thick, thick * rng.uniform(0.85, 1.1)], axis=1))]


def angle_block(rng: np.random.Generator) -> Parts:
    """L, T and U shapes."""
    length, thick = rng.uniform(0.04, 0.14), rng.uniform(0.012, 0.045)
    height, rise = rng.uniform(0.015, 0.08), rng.uniform(0.03, 0.12)
    places = {0: [length / 2], 1: [0.0], 2: [-length / 2, length / 2]}[int(rng.integers(3))]
    base = box([length + thick, height, thick], [0, 0, thick / 2])
    return [base, *[box([thick, height, rise], [x, 0, thick + rise / 2 - 1e-4]) for x in places]]


def bricks(rng: np.random.Generator) -> Parts:
    unit = rng.uniform(0.015, 0.035)
    parts: Parts = []
    for level in range(rng.integers(1, 4)):
        wide, long = rng.integers(1, 4), rng.integers(1, 5)
        shift = unit * rng.integers(-1, 2, 2) * (level > 0)
        parts.append(box([unit * wide, unit * long, 1.02 * unit], [*shift, unit * level]))
    return parts


def toy(rng: np.random.Generator) -> Parts:
    """Two to six rounded pieces that touch one another."""
    parts: Parts = []
    centre = np.zeros(3)
    for _ in range(rng.integers(2, 7)):
        half = np.exp(rng.uniform(np.log(0.008), np.log(0.05), 3))
        if parts:
            other = parts[rng.integers(len(parts))]
            low, high = other.bounds
            centre = np.clip(rng.normal((low + high) / 2, high - low), low, high)
            centre += half * rng.uniform(-0.6, 0.6, 3)
        parts.append(rounded(half, rng.choice([0.15, 0.5, 1.0]), centre))
    return parts


def plane(rng: np.random.Generator) -> Parts:
    length, radius = rng.uniform(0.1, 0.26), rng.uniform(0.012, 0.035)
    body = rounded([length / 2, radius, radius], rng.uniform(0.3, 0.9))
    span, chord = rng.uniform(0.08, 0.24), rng.uniform(0.025, 0.06)
    wing = box(
        [chord, span, rng.uniform(0.004, 0.015)],
        [rng.uniform(-0.2, 0.2) * length, 0, rng.uniform(-1, 1) * radius],
    )
    tail = box([0.5 * chord, 0.4 * span, 0.006], [-0.45 * length, 0, 0])
    fin = box([0.5 * chord, 0.006, 2.5 * radius], [-0.45 * length, 0, radius])
    return [body, wing, tail, fin]


def peg_board(rng: np.random.Generator) -> Parts:
    width, length, thick = rng.uniform(0.06, 0.15), rng.uniform(0.06, 0.15), rng.uniform(0.015, 0.03)
    pegs = []
    for _ in range(rng.integers(1, 8)):
        peg = turned(
            [(rng.uniform(0.004, 0.01),) * 1 + (thick - 0.001,), (0.007, thick + rng.uniform(0.01, 0.05))]
        )
        peg.apply_translation([*rng.uniform(-0.4, 0.4, 2) * [width, length], 0])
        pegs.append(peg)
    return [box([width, length, thick], [0, 0, thick / 2]), *pegs]


def star(rng: np.random.Generator) -> Parts:
    corners = int(rng.integers(3, 9))
    angle = np.linspace(0, 2 * np.pi, 2 * corners, endpoint=False)
    radius = rng.uniform(0.03, 0.1) * np.where(np.arange(2 * corners) % 2, rng.uniform(0.45, 1.0), 1.0)
    outline = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return [plate(outline, rng.uniform(0.01, 0.12))]


def tray(rng: np.random.Generator) -> Parts:
    """An open box: a floor and four walls."""
    width, length, height = rng.uniform(0.05, 0.2), rng.uniform(0.05, 0.25), rng.uniform(0.015, 0.08)
    thick = rng.uniform(0.002, 0.008)
    walls = [box([thick, length, height], [side * width / 2, 0, height / 2]) for side in (-1, 1)]
    walls += [box([width + thick, thick, height], [0, side * length / 2, height / 2]) for side in (-1, 1)]
    return [box([width + thick, length + thick, thick], [0, 0, thick / 2]), *walls]
