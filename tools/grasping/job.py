"""One round under several conditions, in a worker: each result is kept in a file of its own.

Knows where results lie and what they depend on; knows nothing of tables.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np

from mapping.errors import ContraMapError
from mapping.files import write_atomically
from mapping.plain_json import plain
from sim_scenes.object_source import object_source
from sim_scenes.objects.mesh_folder import FolderConfig
from tools.grasping.attempt import STRICT, Protocol
from tools.grasping.play import condition, play
from tools.grasping.rounds import Round, RoundConfig, composed, from_scene
from tools.grasping.vgn_network import load_network
from tools.runs.kept import read_kept

FORMAT = 1
"""Raised when results would be others than before: older ones are made again."""
KEYS = ("settings", "objects", "cleared", "ended", "attempts")
WORDS = ("auto", "ycb", "builtin", "figures")


@dataclass(frozen=True)
class Objects:
    """Where a round's objects come from: a word or a folder of meshes (see sim_scenes.object_source)."""

    source: str
    ycb_dir: Path | None = None
    part: str = "held-out"

    @property
    def name(self) -> str:
        """A short name for tables and files."""
        return self.source if self.source in WORDS else Path(self.source).name


@dataclass(frozen=True)
class GraspJob:
    """A round: from a scene folder, or the `index`-th of objects in an arrangement."""

    out: Path
    conditions: tuple[str, ...]
    seed: int
    strict: bool
    index: int = 0
    arrangement: str = ""
    objects: Objects | None = None
    scene: Path | None = None
    pictures: bool = False
    ycb_dir: Path | None = None
    vgn: Path | None = None

    @property
    def group(self) -> str:
        """Rounds that are counted together."""
        if self.scene is not None:
            return self.scene.parent.name
        assert self.objects is not None
        return f"{self.objects.name}, {self.arrangement}"

    @property
    def name(self) -> str:
        """Unique among the rounds of an output folder."""
        if self.scene is not None:
            return f"{self.scene.parent.name}_{self.scene.name}"
        assert self.objects is not None
        return f"{self.objects.name}_{self.arrangement}_{self.index:03d}"

    @property
    def protocol(self) -> Protocol:
        return STRICT if self.strict else Protocol()

    def settings(self, name: str) -> dict[str, Any]:
        """All that a result depends on, as it reads back from a file."""
        found = {
            "format": FORMAT,
            "condition": name,
            "round": self.name,
            "group": self.group,
            "seed": self.seed,
            "protocol": asdict(self.protocol),
            "objects": None if self.objects is None else [self.objects.source, self.objects.part],
            "scene": None if self.scene is None else str(self.scene.resolve()),
        }
        return dict(json.loads(json.dumps(found)))

    def file(self, name: str) -> Path:
        """Where the result of a condition is kept."""
        return self.out / "runs" / ("strict" if self.strict else "lift") / name / f"{self.name}.json"

    def kept(self, name: str) -> dict[str, Any] | None:
        """The result of a condition, if it is there and whole."""
        return read_kept(self.file(name), KEYS, settings=self.settings(name))

    @property
    def missing(self) -> list[str]:
        """Conditions without a result."""
        return [name for name in self.conditions if self.kept(name) is None]

    def start(self) -> Round:
        """The round's first state. Raises DataError when there are no objects."""
        if self.scene is not None:
            return from_scene(self.scene, self.ycb_dir)
        assert self.objects is not None
        folder = None if self.objects.source in WORDS else FolderConfig(self.objects.part, None, None)
        source = object_source(self.objects.source, self.objects.ycb_dir, folder)
        rng = np.random.default_rng([self.seed, crc32(self.name.encode())])
        return composed(self.name, self.arrangement, source, rng, RoundConfig())


def run_round(job: GraspJob) -> list[dict[str, str]]:
    """Play what is missing of a round; returns what failed as {round, condition, error}."""
    import torch

    from tools.grasping.pictures import Album

    torch.set_num_threads(1)
    todo = job.missing
    try:
        start = job.start() if todo else None
        network = load_network(job.vgn) if job.vgn is not None else None
    except ContraMapError as error:
        return [{"round": job.name, "condition": name, "error": str(error)} for name in todo]
    failures = []
    for name in todo:
        assert start is not None
        album = Album(job.out / "pictures", f"{name}_{job.name}") if job.pictures else None
        try:
            seed = [job.seed, crc32(job.name.encode())]
            look = album or (lambda *_: None)
            result = play(start, condition(name), job.protocol, seed, look=look, network=network)
        except Exception as error:  # whatever a method does, the other conditions go on
            failures.append(
                {"round": job.name, "condition": name, "error": f"{type(error).__name__}: {error}"}
            )
            continue
        content = plain({"settings": job.settings(name), **result})
        job.file(name).parent.mkdir(parents=True, exist_ok=True)
        write_atomically(job.file(name), (json.dumps(content) + "\n").encode())
    return failures
