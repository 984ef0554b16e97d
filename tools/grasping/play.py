"""A round of grasping: look, plan, try, until the table is empty, it fails twice in a row, or ten tries.

Knows a round's start, where shapes come from and which planner; knows nothing of files or tables of figures.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from mapping.errors import ConfigError, DataError
from perception.camera import Camera, transform
from perception.frame import Frame
from sim_scenes.render import Renderer
from sim_scenes.surroundings import Surroundings
from sim_scenes.tabletop import PlacedObject, Tabletop, TabletopConfig
from tools.grasping import vgn
from tools.grasping.antipodal import DoubtConfig, plan
from tools.grasping.attempt import Outcome, Protocol, attempt
from tools.grasping.hand import Grasp, HandConfig
from tools.grasping.rounds import Round
from tools.grasping.shapes import Shapes, shapes_of
from tools.grasping.vgn_network import Network

FAILURES = 2
"""Failures in a row that end a round."""
ATTEMPTS = 10
"""Most attempts of a round."""


@dataclass(frozen=True)
class Condition:
    """A planner on shapes from a source. about: one line for people."""

    name: str
    planner: str
    source: str
    about: str


CONDITIONS = {
    item.name: item
    for item in (
        Condition("raw", "antipodal", "raw", "measured points alone"),
        Condition("tsdf", "antipodal", "tsdf", "a truncated signed distance field an object"),
        Condition("vprism", "antipodal", "vprism", "V-PRISM's meshes"),
        Condition("contramap", "antipodal", "contramap", "ContraMap's meshes"),
        Condition("contramap-unsure", "unsure", "contramap", "ContraMap's meshes, unsure space costs score"),
        Condition("truth", "antipodal", "truth", "the true meshes"),
        Condition("vgn-raw", "vgn", "raw", "VGN on the measured TSDF"),
        Condition("vgn-contramap", "vgn", "contramap", "VGN on the TSDF of ContraMap's meshes"),
        Condition("vgn-truth", "vgn", "truth", "VGN on the TSDF of the true meshes"),
    )
}

Look = Callable[["Seen", Grasp, Outcome, int], None]
"""Called after each attempt with what was there before it, for pictures."""


@dataclass(frozen=True)
class Seen:
    """One look at the table. placed: what truly stood there; shapes: what the planner was told."""

    placed: tuple[PlacedObject, ...]
    camera: Camera
    shapes: Shapes


def condition(name: str) -> Condition:
    """A condition by name; ConfigError lists the valid ones."""
    if name not in CONDITIONS:
        raise ConfigError(f"unknown condition {name!r}; valid conditions: {', '.join(CONDITIONS)}")
    return CONDITIONS[name]


def play(
    start: Round,
    chosen: Condition,
    protocol: Protocol,
    seed: Sequence[int],
    hand: HandConfig | None = None,
    look: Look = lambda *_: None,
    network: Network | None = None,
) -> dict[str, Any]:
    """Attempts of one round as plain values, and how many objects there were and were cleared.

    network: VGN, for the conditions that need it. Every attempt is drawn from `seed` and its number alone.
    """
    hand = hand or HandConfig()
    tries: list[dict[str, Any]] = []
    failures = cleared = 0
    ended = "attempts"
    with Tabletop(TabletopConfig()) as table:
        for item in start.placed:
            table.place(item)
        while len(tries) < ATTEMPTS:
            placed = tuple(table.placed())
            if not placed:
                ended = "empty"
                break
            rng = np.random.default_rng([*seed, len(tries)])
            before = perf_counter()
            try:
                seen = Seen(
                    placed, start.camera, shapes_of(chosen.source, _frame(placed, start.camera), placed, rng)
                )
                grasp = _planned(chosen, seen.shapes, hand, rng, network)
            except DataError:  # nothing that could be mapped is in sight
                grasp = None
            plan_s = perf_counter() - before
            if grasp is None:
                ended = "no grasp"
                break
            outcome = attempt(table, grasp, hand, protocol)
            tries.append(_record(seen, grasp, outcome, plan_s))
            look(seen, grasp, outcome, len(tries) - 1)
            if outcome.held is not None:
                cleared += 1
                failures = 0
                table.remove([outcome.held])
            else:
                failures += 1
                table.settle()
            if failures == FAILURES:
                ended = "failures"
                break
    return {"objects": len(start.placed), "cleared": cleared, "ended": ended, "attempts": tries}


def _planned(
    chosen: Condition,
    shapes: Shapes,
    hand: HandConfig,
    rng: np.random.Generator,
    network: Network | None,
) -> Grasp | None:
    if chosen.planner == "vgn":
        if network is None:
            raise ConfigError(f"condition {chosen.name} needs the weights of VGN: --vgn FILE")
        return vgn.plan(shapes, network)
    return plan(shapes, hand, rng, DoubtConfig() if chosen.planner == "unsure" else None)


def _frame(placed: Sequence[PlacedObject], camera: Camera) -> Frame:
    """What the camera sees: exact depth and labels in the order of the objects."""
    depth, labels = _renderer(placed).depth_and_labels(camera)
    names = {k: item.model.name for k, item in enumerate(placed, start=1)}
    return Frame(depth, camera, None, labels, names, "simulated")


def _renderer(placed: Sequence[PlacedObject]) -> Renderer:
    return Renderer(placed, Surroundings.plain(TabletopConfig().table_size_m))


def _record(seen: Seen, grasp: Grasp, outcome: Outcome, plan_s: float) -> dict[str, Any]:
    label = grasp.label or _nearest(seen.placed, grasp)
    return {
        "success": outcome.success,
        "reason": outcome.reason,
        "touched": outcome.touched,
        "target": seen.placed[label - 1].model.name,
        "hidden": _hidden(seen, label),
        "score": grasp.score,
        "width": grasp.width,
        "down": float(-grasp.T_world_hand[2, 2]),
        **grasp.details,
        "plan_s": plan_s,
    }


def _nearest(placed: Sequence[PlacedObject], grasp: Grasp) -> int:
    """Label of the object whose surface is nearest to the point between the tips."""
    tip = grasp.T_world_hand[:3, 3]
    gaps = [
        np.linalg.norm(transform(item.T_world_object, item.model.mesh.vertices) - tip, axis=1).min()
        for item in placed
    ]
    return int(np.argmin(gaps)) + 1


def _hidden(seen: Seen, label: int) -> float:
    """Share of an object that others hide from the camera: 1 - its pixels / those it would have alone."""
    assert seen.shapes.frame.labels is not None
    _, labels = _renderer(seen.placed[label - 1 : label]).depth_and_labels(seen.camera)
    return 1 - float((seen.shapes.frame.labels == label).sum()) / max(int((labels == 1).sum()), 1)
