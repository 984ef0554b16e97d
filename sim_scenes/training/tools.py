"""Random tools for the occlusion prior: rods, cutlery, scissors, drills. Each a list of watertight parts."""

from __future__ import annotations

import numpy as np
import trimesh

from sim_scenes.training.mesh_blocks import box, ring, rounded, swept, turned
from sim_scenes.training.vessels import wall

Parts = list[trimesh.Trimesh]


def rod(rng: np.random.Generator) -> Parts:
    """Markers, screwdrivers, candles, rolling pins: turned about their long axis."""
    length, radius = rng.uniform(0.08, 0.26), rng.uniform(0.005, 0.018)
    cuts = np.sort(rng.uniform(0.1, 0.9, rng.integers(1, 4)))
    outline = [(radius, 0.0)]
    for cut in cuts:
        outline.append((outline[-1][0], cut * length))
        outline.append((radius * rng.uniform(0.25, 1.1), cut * length + 0.004))
    rod = turned([*outline, (outline[-1][0], length)])
    rod.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [0, 1, 0]))
    return [rod]


def cutlery(rng: np.random.Generator) -> Parts:
    """Spoons, knives, forks, spatulas: a bent flat handle and a head."""
    length, lift = rng.uniform(0.09, 0.18), rng.uniform(0, 0.015)
    share = np.linspace(0, 1, 9)
    path = np.stack([length * share, 0 * share, 0.004 + lift * np.sin(np.pi * share)], axis=1)
    width, thick = rng.uniform(0.003, 0.012), rng.uniform(0.001, 0.004)
    handle = swept(path, np.stack([width * (1.2 - 0.6 * share), np.full(9, thick)], axis=1))
    reach, wide = rng.uniform(0.03, 0.09), rng.uniform(0.008, 0.035)
    kind = rng.integers(4)
    if kind == 0:
        bowl = rng.uniform(0.003, 0.01)
        depth = np.linspace(0, 1, 6)
        vessel = turned(
            wall(reach / 2 * np.sqrt(depth + 0.05), bowl * depth, 0.002, 0.0015), wide / reach * 2
        )
        vessel.apply_translation([length + 0.45 * reach, 0, 0.001])
        return [handle, vessel]
    if kind == 1:
        teeth = [
            box([0.6 * reach, 0.003, 2 * thick], [length + 0.7 * reach, y, 0.005])
            for y in np.linspace(-wide / 2, wide / 2, rng.integers(3, 5))
        ]
        return [
            handle,
            box([0.45 * reach, wide + 0.003, 2 * thick], [length + 0.2 * reach, 0, 0.005]),
            *teeth,
        ]
    blade = box([1.6 * reach, wide, rng.uniform(0.001, 0.004)], [length + 0.8 * reach, 0, 0.004])
    return [handle, blade]


def scissors(rng: np.random.Generator) -> Parts:
    length, thick = rng.uniform(0.07, 0.13), rng.uniform(0.002, 0.006)
    opening = rng.uniform(0.05, 0.5)
    parts: Parts = []
    for sign in (-1, 1):
        blade = box([2 * length, rng.uniform(0.008, 0.018), thick], [0, 0, thick * (1.5 + 0.5 * sign)])
        loop = rng.uniform(0.015, 0.03)
        grip = ring(
            np.array([-length - 0.8 * loop, 0.3 * sign * loop, 2 * thick]), (1.2 * loop, loop), 1.3 * thick
        )
        for part in (blade, grip):
            part.apply_transform(trimesh.transformations.rotation_matrix(sign * opening / 2, [0, 0, 1]))
            parts.append(part)
    return parts


def wrench(rng: np.random.Generator) -> Parts:
    length, width = rng.uniform(0.1, 0.22), rng.uniform(0.008, 0.02)
    thick, head = rng.uniform(0.005, 0.014), rng.uniform(0.012, 0.028)
    bar = box([length, width, thick], [length / 2, 0, thick / 2])
    jaws = [
        box(
            [1.5 * head, 0.6 * head, 1.3 * thick],
            [length + 0.5 * head, side * head * rng.uniform(0.5, 0.8), 0.65 * thick],
        )
        for side in (-1, 1)
    ]
    back = box([0.8 * head, 1.8 * head, 1.3 * thick], [length, 0, 0.65 * thick])
    return [bar, back, *jaws]


def clamp(rng: np.random.Generator) -> Parts:
    length, thick = rng.uniform(0.05, 0.1), rng.uniform(0.012, 0.035)
    gap, width = rng.uniform(0.01, 0.04), rng.uniform(0.01, 0.025)
    arms = []
    for sign in (-1, 1):
        share = np.linspace(-1, 1, 9)
        path = np.stack([length * share, sign * (gap * np.abs(share - 0.1) + 0.3 * width), 0 * share], axis=1)
        arms.append(swept(path, np.tile([width / 2, thick / 2], (9, 1))))
    return [*arms, ring(np.zeros(3), (0.7 * width, 0.7 * width), 0.3 * thick)]


def drill(rng: np.random.Generator) -> Parts:
    length, radius = rng.uniform(0.1, 0.2), rng.uniform(0.02, 0.035)
    height = rng.uniform(0.08, 0.15)
    body = rounded([length / 2, radius, radius], rng.uniform(0.2, 0.7), [0, 0, height])
    grip = rounded([0.02, 0.7 * radius, height / 2], 0.4, [-0.25 * length, 0, height / 2])
    foot = box([rng.uniform(0.04, 0.1), 2 * radius, rng.uniform(0.015, 0.05)], [-0.2 * length, 0, 0.02])
    nose = rounded([0.03, 0.4 * radius, 0.4 * radius], 0.4, [length / 2, 0, height])
    return [body, grip, foot, nose]


def padlock(rng: np.random.Generator) -> Parts:
    width, thick, height = rng.uniform(0.03, 0.06), rng.uniform(0.012, 0.028), rng.uniform(0.025, 0.05)
    angle = np.linspace(0, np.pi, 11)
    reach = rng.uniform(0.02, 0.05)
    bow = np.stack([0.35 * width * np.cos(angle), 0 * angle, height + reach * np.sin(angle) - 0.005], axis=1)
    return [box([width, thick, height], [0, 0, height / 2]), swept(bow, np.full((11, 2), 0.25 * thick))]


def chain(rng: np.random.Generator) -> Parts:
    wire, loop = rng.uniform(0.002, 0.005), rng.uniform(0.008, 0.018)
    at, heading = np.zeros(3), rng.uniform(0, 2 * np.pi)
    parts: Parts = []
    for _ in range(rng.integers(6, 18)):
        heading += rng.normal(0, 0.9)
        link = ring(np.zeros(3), (1.5 * loop, loop), wire)
        link.apply_transform(trimesh.transformations.euler_matrix(rng.uniform(-0.9, 0.9), 0, heading))
        link.apply_translation(at + np.array([0, 0, loop]))
        at = at + 2.2 * loop * np.array([np.cos(heading), np.sin(heading), 0])
        parts.append(link)
    return parts


def hammer(rng: np.random.Generator) -> Parts:
    length, radius = rng.uniform(0.15, 0.28), rng.uniform(0.008, 0.014)
    shaft = rounded([length / 2, radius, radius], 0.4, [0, 0, 0])
    head = rounded(
        [rng.uniform(0.01, 0.02), rng.uniform(0.03, 0.06), rng.uniform(0.01, 0.02)], 0.3, [length / 2, 0, 0]
    )
    return [shaft, head]
