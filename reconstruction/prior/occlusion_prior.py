"""A prior for what is hidden: which object, if any, fills a point that no ray has reached.

Learned from procedural shapes and household meshes (tools/train_prior.py); prior_weights.json beside the
weights says which.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import torch

from mapping.errors import DataError
from mapping.threads import Threads
from reconstruction.prior.features import (
    LATTICE,
    LATTICE_CHANNELS,
    Evidence,
    ObjectBox,
    RayEvidence,
    channels,
)
from reconstruction.prior.footprint import Footprint, footprint_channels
from reconstruction.prior.network import POINT_NAMES, PriorNetwork, architecture
from reconstruction.prior.revolution import Revolution

WEIGHTS_FILE = Path(__file__).with_name("prior_weights.npz")
ARCHITECTURE = "architecture"
"""Entry of a weights file that says which network it is for."""
OUTSIDE = -12.0
"""Log odds of an object outside its box."""

FEW = 3000
"""So few points that are asked about later are answered for all objects at once: a call for each would cost
more than the answers."""


class OcclusionPrior:
    """P(empty), P(object k) at hidden points of one frame: the ShapePrior that comes with the project."""

    def __init__(self, network: PriorNetwork) -> None:
        self.network = network.eval()

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of what the decoder looks at, at a point."""
        return POINT_NAMES

    @classmethod
    def load(cls, path: Path = WEIGHTS_FILE) -> OcclusionPrior:
        """The prior from a weights file; raises DataError when it does not fit the network."""
        if not path.is_file():
            raise DataError(f"{path}: no such weights file; `python -m tools.train_prior` makes one")
        return _load(path, path.stat().st_mtime_ns)

    def distribution(
        self,
        visible: Sequence[np.ndarray],
        origin: np.ndarray,
        evidence: Evidence,
        points: np.ndarray,
        floors: Sequence[float] | None = None,
        memo: dict[Any, Any] | None = None,
        only: tuple[int, ...] | None = None,
    ) -> np.ndarray:
        """Class distribution (N, K+1) float32 over {empty, object 1..K} at points (N, 3).

        visible: (M, 3) float32 visible points of each object; origin: (3,) where the rays start; evidence:
        what the rays say of points. All in the table frame [m]. floors: heights of the supports that the
        objects stand on, 0 by default. memo: keeps what is worked out of the objects and not of the points,
        for the next points of the same frame. only: objects that are asked about; the others are taken to be
        absent. Meant for hidden points; points that rays have passed through are the caller's to exclude.
        """
        odds = self.log_odds(visible, origin, evidence, points, floors, memo, only)
        # Log odds compare an object with "empty", so one softmax gives every point one distribution.
        odds = np.concatenate([np.zeros((len(odds), 1), np.float32), odds], axis=1)
        odds = np.exp(odds - odds.max(axis=1, keepdims=True))
        return odds / odds.sum(axis=1, keepdims=True)

    def log_odds(
        self,
        visible: Sequence[np.ndarray],
        origin: np.ndarray,
        evidence: Evidence,
        points: np.ndarray,
        floors: Sequence[float] | None = None,
        memo: dict[Any, Any] | None = None,
        only: tuple[int, ...] | None = None,
    ) -> np.ndarray:
        """Log odds (N, K) float32 of each object against its absence; OUTSIDE beyond its box or below its
        floor, and of objects that are not asked about."""
        points = np.asarray(points, np.float32)
        result = np.full((len(points), len(visible)), OUTSIDE, np.float32)
        asked = tuple(range(len(visible))) if only is None else only
        if not asked:
            return result
        # The network knows one support only, at height 0: every object is moved down onto it.
        lifts = [np.array([0, 0, floor], np.float32) for floor in floors or [0.0] * len(visible)]
        visible = [item - lift if lift.any() else item for item, lift in zip(visible, lifts)]
        lattices = np.empty((len(asked), LATTICE_CHANNELS, *LATTICE), np.float32)
        boxes: dict[int, ObjectBox] = {}
        bodies: dict[int, Revolution] = {}
        plans: dict[int, Footprint] = {}

        def look(place: int) -> None:
            index = asked[place]
            boxes[index] = ObjectBox.around(visible[index], origin - lifts[index])
            around = evidence(boxes[index].lattice() + lifts[index], index)
            lattices[place] = lattice_channels(boxes[index], visible[index], around)
            bodies[index] = Revolution.of(
                boxes[index], visible[index], lambda where: evidence(where + lifts[index], index)
            )

        def encode(part: slice) -> torch.Tensor:
            with torch.inference_mode():
                return self.network.encode(torch.from_numpy(lattices[part]))

        def known_of(place: int) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
            index = asked[place]
            box, floor = boxes[index], lifts[index][2]
            local = box.local(points - lifts[index] if floor else points)
            x, y, z = np.abs(local.T) <= 1
            rows = np.flatnonzero(x & y & z & (points[:, 2] >= floor))
            if len(rows) == 0:
                return None
            local = local.T.take(rows, axis=1).T  # each axis stays in one piece
            if index not in plans:
                plans[index] = Footprint.of(box, visible[index])
            plan = plans[index].at(box, local)
            known = point_channels(
                local,
                evidence(points[rows], index),
                box.scalars()[:, None],
                *plan,
                bodies[index].channels(box, local),
            )
            return rows, local, known

        def decode(place: int) -> None:
            if (found := known_of(place)) is not None:
                rows, local, known = found
                with torch.inference_mode():
                    odds = self.network.decode(
                        features[place : place + 1],
                        torch.from_numpy(local)[None],
                        torch.from_numpy(known).T[None],
                    )
                result[rows, asked[place]] = odds[0].numpy()

        def decode_few(found: list[tuple[np.ndarray, np.ndarray, np.ndarray] | None]) -> None:
            few = [(place, *of_one) for place, of_one in enumerate(found) if of_one is not None]
            if few:
                places, rows, local, known = zip(*few)
                owner = np.repeat(np.array(places, np.int32), [len(own) for own in rows])
                with torch.inference_mode():
                    odds = self.network.decode_rows(
                        features,
                        owner,
                        torch.from_numpy(np.concatenate(local)),
                        torch.from_numpy(np.concatenate(known, axis=1)).T,
                    )
                result[np.concatenate(rows), np.array(asked)[owner]] = odds.numpy()

        with Threads() as threads:
            again = memo is not None and (self, asked) in memo
            if memo is not None and again:
                features, boxes, bodies, plans = memo[self, asked]
            else:
                threads.map(look, range(len(asked)))
                # A batch a thread: one object at a time costs five times as much.
                parts = threads.split(len(asked)) if only is None else batches(len(asked), threads)
                features = torch.cat(threads.map(encode, parts))
                if memo is not None:
                    memo[self, asked] = features, boxes, bodies, plans
            if again and len(points) <= FEW:
                decode_few(threads.map(known_of, range(len(asked))))
            else:
                threads.map(decode, range(len(asked)))
        return result


def batches(count: int, threads: Threads) -> list[slice]:
    """0..count in parts, none of them of one alone where there are more: a single object costs three times
    its share of two."""
    return threads.split(count) if count > 3 else [slice(0, count)]


def lattice_channels(box: ObjectBox, visible: np.ndarray, seen: RayEvidence) -> np.ndarray:
    """The encoder's input (LATTICE_CHANNELS, *LATTICE) float32; seen: the evidence at box.lattice()."""
    rows = channels(lattice_coordinates(), seen, box.scalars()[:, None])
    held = box.surface_cells(visible)[None].astype(np.float32)
    return np.concatenate([rows, held]).reshape(-1, *LATTICE)


def point_channels(
    local: np.ndarray,
    seen: RayEvidence,
    scalars: np.ndarray,
    distance: np.ndarray,
    above: np.ndarray,
    turned: np.ndarray,
) -> np.ndarray:
    """The decoder's input (POINT_CHANNELS, N) float32 at points (N, 3) in box coordinates.

    seen: the evidence there; scalars: of the box (6, 1); distance, above: (N,) as Footprint.at gives them;
    turned: (REVOLUTION_CHANNELS, N) as Revolution.channels gives them.
    """
    rows = channels(local, seen, scalars)
    return np.concatenate([rows, footprint_channels(distance, above, scalars[0]), turned])


@lru_cache(maxsize=1)
def lattice_coordinates() -> np.ndarray:
    """Box coordinates (V, 3) float32 of the lattice's cell centres."""
    axes = [(np.arange(cells) + 0.5) / cells * 2 - 1 for cells in LATTICE]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3).astype(np.float32)


@lru_cache(maxsize=2)
def _load(path: Path, modified: int) -> OcclusionPrior:
    network = PriorNetwork()
    with np.load(path) as stored:
        made_for = json.loads(str(stored[ARCHITECTURE])) if ARCHITECTURE in stored.files else None
        state = {
            name: torch.from_numpy(stored[name].astype(np.float32))
            for name in stored.files
            if name != ARCHITECTURE
        }
    if made_for != architecture():
        differs = sorted(key for key, value in architecture().items() if (made_for or {}).get(key) != value)
        raise DataError(
            f"{path}: made for another network (other {', '.join(differs)}); train it again with "
            "`python -m tools.train_prior`"
        )
    try:
        network.load_state_dict(state)
    except RuntimeError as error:
        raise DataError(f"{path}: made for another network; train it again ({error})") from error
    return OcclusionPrior(network)


def save_weights(network: PriorNetwork, path: Path) -> None:
    """Write the weights of a plain network in half precision, with what they are for: 1.5 MB."""
    state = {
        name: value.detach().cpu().numpy().astype(np.float16) for name, value in network.state_dict().items()
    }
    state[ARCHITECTURE] = np.array(json.dumps(architecture()))
    temporary = path.with_name(path.name + ".tmp.npz")
    np.savez(temporary, **state)
    temporary.rename(path)
