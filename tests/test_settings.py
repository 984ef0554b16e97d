"""Every setting acts in both commands or is refused."""

from __future__ import annotations

import hashlib
import json
from dataclasses import fields, is_dataclass, replace
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import numpy as np
import pytest
from conftest import Shape, make_tabletop

from mapping import ConfigError, ContraMap, MapConfig
from mapping.errors import ContraMapError
from mapping.settings import Range, override
from perception.frame import Frame
from perception.observing import observe
from perception.space import Space
from reconstruction.config import PipelineConfig, preset
from reconstruction.fitted_scene import FittedScene
from tools.evaluation.fitted_map import View
from tools.evaluation.methods import method

# A box behind a pole (two pieces), a flat tile, a ball, a wall: something for every setting of perception.
SHAPES = (
    Shape("box", (0.05, 0.20, 0.12), (0.10, 0.0, 0.06)),
    Shape("cylinder", (0.02, 0.20), (-0.03, 0.0, 0.10)),
    Shape("box", (0.06, 0.06, 0.006), (0.0, -0.16, 0.003)),
    Shape("sphere", (0.035,), (-0.02, 0.16, 0.035)),
)
WALL = Shape("box", (0.02, 1.6, 0.9), (0.42, 0.0, 0.3))


@pytest.fixture(scope="module")
def labelled() -> Frame:
    """Noise, flying pixels at edges, and a label that bleeds onto the wall."""
    frame = make_tabletop(SHAPES, size=(160, 120), noise=0.006, background=(WALL,)).frame
    assert frame.labels is not None
    labels, depth = frame.labels.copy(), frame.depth.copy()
    beside = np.roll(depth, 1, 1)
    flying = (labels != np.roll(labels, 1, 1)) & (np.random.default_rng(0).random(depth.shape) < 0.7)
    depth[flying] = (depth + beside)[flying] / 2
    rows, columns = np.nonzero(labels == 1)
    labels[rows.min() - 6 : rows.min(), columns.min() + 3 : columns.max() - 3] = 1
    return replace(frame, labels=labels, depth=depth)


@pytest.fixture(scope="module")
def unlabelled(labelled: Frame) -> Frame:
    return replace(labelled, labels=None)


def leaves(config: Any, path: str = "") -> list[tuple[str, Any]]:
    """(dotted name, annotation) of every setting below a section."""
    hints = get_type_hints(type(config), include_extras=True)
    found: list[tuple[str, Any]] = []
    for field in fields(config):
        name, value = f"{path}.{field.name}".lstrip("."), getattr(config, field.name)
        found += leaves(value, name) if is_dataclass(value) else [(name, hints[field.name])]
    return found


TABLETOP, PAPER = preset("tabletop"), preset("paper")
ALL = [("tabletop", name) for name, _ in leaves(TABLETOP)] + [
    ("paper", name) for name, _ in leaves(PAPER) if name.startswith("samples.")
]
NO_RESULT = {
    "map.device": "where the same numbers are worked out; see test_an_unknown_device_is_refused",
    "samples.radius_share": "acts on objects wider than 25 cm; see tests/test_object_room.py",
    "mesh.smallest_part": "drops parts that nobody saw; these scenes have none",
    "mesh.fusion.unseen_walls": "closes tunnels; these objects have none; see tests/test_unseen_walls.py",
    "map.fit.warm": "acts on fits from earlier weights; see tests/test_contramap.py",
    "perception.segment_reach": "chooses among planes of an unlabelled frame with several tables",
}
"""Settings that are not to change this frame's result, and why."""
WITHOUT_LABELS = ("perception.segment", "perception.plane_points", "perception.plane_candidates")
"""Settings that are felt where there are no labels."""
OTHER = {
    "perception.minimum_pixels": 2000,
    "perception.plane_candidates": 1,
    "perception.plane_points": 100,
    "perception.plane_iterations": 1,
    "perception.plane_threshold": 0.004,
    "perception.largest_object": 0.1,
    "perception.other_reach": 0.01,
    "perception.plane_minimum_share": 0.9,
    "perception.plane_reach": 0.02,
    "perception.split_gap": 0.001,
    "perception.cluster_gap": 0.5,
    "perception.flat_height": 0.2,
    "perception.segment_height": 0.05,
    "perception.segment_float": 0.0005,
    "perception.segment_minimum_area": 0.01,
    "samples.finest_distance": None,
    "samples.thin": 1.0,
    "mesh.floor": 0.01,
    "mesh.smallest_part": 1.0,
    "mesh.max_uncertainty": 0.3,
    "mesh.margin": 0.01,
    "map.far_uncertainty": 0.5,
    "map.fit.max_iterations": 3,
    "map.fit.renew": 5,
}
"""Values that must be felt, where half as much again is not enough."""
TOGETHER = {
    "samples.shell": {"samples": {"prior": "none"}},
    "mesh.keep_seen": {"mesh": {"fusion": {"enabled": False}}},
}
"""Settings that act beside another one only; what the other must be."""


LATER = ("perception.depth_noise", "perception.surface_margin")
"""Settings of perception that act on space, not on objects."""


def another(name: str, value: Any, hint: Any) -> Any:
    """A valid value other than the default."""
    if name in OTHER:
        return OTHER[name]
    if isinstance(value, bool):
        return not value
    if get_origin(hint) is Literal:
        return next(choice for choice in get_args(hint) if choice != value)
    bounds = (
        [part for part in get_args(hint) if isinstance(part, Range)] if get_origin(hint) is Annotated else []
    )
    changed = 2 * value if isinstance(value, int) else 1.5 * value if value else 0.5
    return changed if all(bound.holds(changed) for bound in bounds) else value / 2


def nested(name: str, value: Any) -> dict[str, Any]:
    for part in reversed(name.split(".")):
        value = {part: value}
    return value


def at(config: Any, name: str) -> Any:
    for part in name.split("."):
        config = getattr(config, part)
    return config


def fingerprint(scene: FittedScene, observed_only: bool = False) -> str:
    """What a scene gives, objects, map and meshes; an error that it ends in is a result as well."""
    digest = hashlib.sha1()
    try:
        digest.update(str(len(scene.observation.other.points)).encode())
        for item in scene.observation.objects:
            digest.update(f"{item.label} {item.points.tobytes()!r}".encode())
        if observed_only:
            return digest.hexdigest()
        digest.update(scene.map.W.numpy().tobytes())
        for surface in scene.meshes:
            digest.update(surface.mesh.vertices.tobytes() if surface else b"none")
            digest.update(surface.uncertainty.tobytes() if surface else b"none")
    except ContraMapError as error:
        digest.update(str(error).encode())
    return digest.hexdigest()


class Walk:
    """Fingerprints of one frame with other settings, through reconstruct's scene or evaluate's method."""

    def __init__(self, frame: Frame) -> None:
        self.frame, self.known = frame, {}
        observation = observe(frame)
        self.view = View(frame, observation, Space.of(observation))

    def reconstruct(self, config: PipelineConfig, observed_only: bool) -> str:
        key = ("reconstruct", config, observed_only)
        return self._once(key, lambda: FittedScene.of(self.frame, config), observed_only)

    def evaluate(self, name: str) -> str:
        def scene() -> FittedScene:
            return method(name).fit(self.view, np.random.default_rng(0)).scene  # type: ignore[attr-defined]

        return self._once(("evaluate", name), scene)

    def _once(self, key: Any, make: Any, observed_only: bool = False) -> str:
        if key not in self.known:
            try:
                self.known[key] = fingerprint(make(), observed_only)
            except ContraMapError as error:
                self.known[key] = str(error)
        return self.known[key]


@pytest.fixture(scope="module")
def walks(labelled: Frame, unlabelled: Frame) -> dict[bool, Walk]:
    return {True: Walk(labelled), False: Walk(unlabelled)}


def changed(preset_name: str, name: str) -> tuple[PipelineConfig, PipelineConfig, Any]:
    """The configuration with and without another value of one setting, and that value."""
    base = override(preset(preset_name, "cpu"), TOGETHER.get(name, {}))
    hint = dict(leaves(base))[name]
    value = another(name, at(base, name), hint)
    return base, override(base, nested(name, value)), value


@pytest.mark.parametrize(("preset_name", "name"), [pair for pair in ALL if pair[1] not in NO_RESULT])
def test_every_setting_acts_in_reconstruct(walks: dict[bool, Walk], preset_name: str, name: str) -> None:
    base, other, value = changed(preset_name, name)
    walk = walks[not name.startswith(WITHOUT_LABELS)]
    # What changes the objects need not be followed to the meshes: that takes most of the time.
    observed_only = name.startswith("perception.") and name not in LATER
    before, after = walk.reconstruct(base, observed_only), walk.reconstruct(other, observed_only)
    assert after != before, f"{name}={value} changes nothing"


SOME = [
    "perception.table_margin",
    "samples.pair_offset",
    "samples.labels.least_uncertain",
    "map.l2",
    "mesh.margin",
]
"""One of every section; `pytest -m slow` walks over all."""


@pytest.mark.parametrize(
    ("preset_name", "name"),
    [
        pytest.param(*pair, marks=() if pair in [("tabletop", name) for name in SOME] else pytest.mark.slow)
        for pair in ALL
        if pair[1] not in NO_RESULT and not pair[1].startswith(WITHOUT_LABELS)
    ],
)
def test_every_setting_acts_in_evaluate(walks: dict[bool, Walk], preset_name: str, name: str) -> None:
    method_name = {"tabletop": "contramap", "paper": "contramap-paper"}[preset_name]
    _, _, value = changed(preset_name, name)
    given = [
        f"{section}.{field}={json.dumps(text)}"
        for section, inner in TOGETHER.get(name, {}).items()
        for field, text in inner.items()
    ]
    base = ":".join([method_name, ",".join(given)]).rstrip(":")
    other = f"{method_name}:{','.join([*given, f'{name}={json.dumps(value)}'])}"
    assert walks[True].evaluate(other) != walks[True].evaluate(base), f"{name}={value} changes nothing"


def test_an_unknown_device_is_refused() -> None:
    with pytest.raises(ConfigError, match="auto, cpu, cuda"):
        ContraMap(MapConfig(device="abacus"))  # type: ignore[arg-type]
    assert ContraMap(MapConfig(device="auto")).device.type == "cpu"
