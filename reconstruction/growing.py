"""A map that grows frame by frame, and what became of each frame.

Knows frames, reconstruct and update; knows nothing of where frames come from, files or clocks.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from mapping.errors import ContraMapError
from perception.frame import Frame
from reconstruction.config import PipelineConfig
from reconstruction.result import Reconstruction
from reconstruction.scene import reconstruct


@dataclass(frozen=True)
class Taken:
    """What became of one frame.

    name: the frame's. version: of the map after it, from 1; 0 before there is one. skipped: why it did not
    count, None where it did. uncertainty: mean p(uncertain) of all vertices after it, NaN without a map.
    stamp: when it was taken [s].
    """

    name: str
    version: int
    skipped: str | None
    objects: int
    uncertainty: float
    stamp: float | None = None


@dataclass
class GrowingMap:
    """The map of all frames so far. track: equal label numbers are the same object in all frames; keep: so
    many views at most, see Reconstruction.update."""

    config: PipelineConfig
    seed: int = 0
    track: bool = False
    keep: int | None = None
    result: Reconstruction | None = None
    taken: list[Taken] = field(default_factory=list)

    @property
    def version(self) -> int:
        """Counts the frames that the map was changed by."""
        return self.taken[-1].version if self.taken else 0

    def add(self, frame: Frame, name: str, stamp: float | None = None) -> Taken:
        """Map one frame more. One that cannot be used, or contradicts the others, is skipped: it leaves the
        map as it is."""
        before, reason = self.result, None
        try:
            if before is None:
                self.result = reconstruct(frame, self.config, self.seed)
            else:
                self.result = before.update(frame, self.track, self.keep)
                if self.result.map is before.map:
                    said = [note for note in self.result.notes if note not in before.notes]
                    reason = "; ".join(said) or "it says nothing new"
        except ContraMapError as error:
            reason = _line(error)
        return self._note(name, stamp, reason)

    def skip(self, name: str, error: Exception, stamp: float | None = None) -> Taken:
        """Record a frame that could not be read."""
        return self._note(name, stamp, _line(error))

    def describe(self) -> dict[str, Any]:
        """For scene.json: the version, and what became of each frame."""
        return {"version": self.version, "frames": [asdict(one) for one in self.taken]}

    def remember(self, described: Mapping[str, Any]) -> None:
        """Take up what became of earlier frames, as `describe` said it."""
        for entry in described["frames"]:
            unsure = entry["uncertainty"]
            self.taken.append(Taken(**{**entry, "uncertainty": np.nan if unsure is None else unsure}))

    def _note(self, name: str, stamp: float | None, reason: str | None) -> Taken:
        result = self.result
        unsure = np.nan if result is None else mean_uncertainty(result)
        version = self.version + (reason is None)
        objects = 0 if result is None else len(result.objects)
        self.taken.append(Taken(name, version, reason, objects, unsure, stamp))
        return self.taken[-1]


def mean_uncertainty(result: Reconstruction) -> float:
    """Mean p(uncertain) of the vertices of all objects."""
    return float(np.concatenate([item.uncertainty for item in result.objects]).mean())


def _line(error: Exception) -> str:
    return " ".join(str(error).split())
