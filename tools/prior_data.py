"""Training data of the occlusion prior: what it would see of random scenes, and the truth at points."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path

import numpy as np

from mapping.errors import FrameError
from mapping.files import temporary_beside
from mapping.samples import shift_along_rays
from perception.camera import transform
from perception.observing import observe
from perception.space import Space
from reconstruction.prior.evidence import RayLookup
from reconstruction.prior.features import LATTICE, ObjectBox, RayEvidence, channels
from reconstruction.prior.footprint import Footprint
from reconstruction.prior.occlusion_prior import lattice_coordinates, point_channels
from reconstruction.prior.revolution import Revolution
from sim_scenes.training.scenes import TrainingScene, inside, make_training_scene
from sim_scenes.training.shapes import TrainingShape
from tools.runs.workers import map_in_workers

QUERIES = 1280
"""Points with truth kept of each object."""
NEAR, BEHIND = 384, 448
"""How many of them lie right behind a visible point and further behind one; the others are anywhere."""
NEAR_REACH = 0.02
"""Right behind a visible point: up to this far [m]. Whether a wall is thin is decided here."""
REACH = 0.15
"""Further behind: up to this far [m], or farther for large objects:"""
REACH_SHARE = 0.6
"""up to this share of the side of the object's box."""
PART = 100
"""Scenes a file of kept examples holds."""
LEAST_BEHIND = 0.0005
"""Points must lie this far behind the first surface [m]."""


FARTHEST_INSIDE = 2.0
"""Distances to a silhouette's border are kept up to this [m]: beyond a quarter of a box's side they say the
same, and beside pixels that saw nothing they are beyond all measure."""


@dataclass(frozen=True)
class Examples:
    """Objects as the prior sees them. B objects, V lattice cells, Q points; evidence as in RayEvidence."""

    scalars: np.ndarray  # (B, 6) float32
    behind: np.ndarray  # (B, V) float16 [m]
    seen: np.ndarray  # (B, V) int8
    inside: np.ndarray  # (B, V) float16 [m]
    surface: np.ndarray  # (B, V) bool
    local: np.ndarray  # (B, Q, 3) float32
    point_behind: np.ndarray  # (B, Q) float32 [m]
    point_seen: np.ndarray  # (B, Q) int8
    point_inside: np.ndarray  # (B, Q) float32 [m]
    plan_distance: np.ndarray  # (B, Q) float16 [m], as Footprint.at gives it
    plan_above: np.ndarray  # (B, Q) float16 [m], likewise
    turned: np.ndarray  # (B, Q, R) float16, as Revolution.channels gives them
    truth: np.ndarray  # (B, Q) bool
    family: np.ndarray  # (B,) str

    def __len__(self) -> int:
        return len(self.scalars)

    def inputs(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Lattices (b, C, *LATTICE), local points (b, Q, 3), their channels (b, Q, P) and truth (b, Q)."""
        return self.lattices(rows), *self.points(rows)

    def lattices(self, rows: np.ndarray) -> np.ndarray:
        """What the encoder sees (b, C, *LATTICE)."""
        lattices = []
        for row in rows:
            around = RayEvidence(self.behind[row], self.seen[row], self.inside[row])
            cells = channels(lattice_coordinates(), around, self.scalars[row][:, None])
            held = self.surface[row][None].astype(np.float32)
            lattices.append(np.concatenate([cells, held]).reshape(-1, *LATTICE))
        return np.stack(lattices)

    def points(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What the decoder sees: local points (b, Q, 3) and their channels (b, Q, P), with truth (b, Q)."""
        points = []
        for row in rows:
            of_points = RayEvidence(self.point_behind[row], self.point_seen[row], self.point_inside[row])
            plan = self.plan_distance[row].astype(np.float32), self.plan_above[row].astype(np.float32)
            scalars = self.scalars[row][:, None]
            turned = self.turned[row].T.astype(np.float32)
            points.append(point_channels(self.local[row], of_points, scalars, *plan, turned).T)
        return self.local[rows], np.stack(points), self.truth[rows].astype(np.float32)


def make_examples(
    scenes: int,
    draw: Callable[[np.random.Generator], TrainingShape],
    seed: int,
    progress: str = "scenes",
    cache: Path | None = None,
    workers: int = 1,
) -> Examples:
    """Examples of all objects of `scenes` random scenes; scene i depends on (seed, i) alone.

    workers: processes that make them, with the same result. cache: a folder to keep them in, part by part;
    parts that are there are read instead, so that a run that was stopped goes on where it was.
    """
    from tqdm import tqdm

    one = partial(_examples_of, draw, seed)
    parts: list[dict[str, np.ndarray]] = []
    todo: Callable = partial(map, one) if workers == 1 else partial(map_in_workers, one, workers=workers)
    with tqdm(total=scenes, desc=progress, mininterval=5) as bar:
        for first in range(0, scenes, PART):
            indices = range(first, min(first + PART, scenes))
            file = cache and cache / f"scenes_{first}_{indices[-1]}.npz"
            if file is not None and file.is_file():
                with np.load(file) as stored:
                    parts.append({name: stored[name] for name in stored.files})
                bar.update(len(indices))
                continue
            rows: list[tuple] = []
            for found in todo(indices):
                rows.extend(found)
                bar.update()
            if not rows:
                continue
            names = (field.name for field in fields(Examples))
            parts.append({name: np.stack(column) for name, column in zip(names, zip(*rows))})
            if file is not None:
                file.parent.mkdir(parents=True, exist_ok=True)
                with temporary_beside(file) as unfinished, unfinished.open("wb") as stream:
                    np.savez(stream, **parts[-1])  # type: ignore[arg-type]
    return Examples(**{name: np.concatenate([part[name] for part in parts]) for name in parts[0]})


def _examples_of(draw: Callable[[np.random.Generator], TrainingShape], seed: int, index: int) -> list[tuple]:
    """The rows of scene `index`."""
    rng = np.random.default_rng([seed, index])
    return list(scene_examples(make_training_scene(draw, rng), rng))


def scene_examples(scene: TrainingScene, rng: np.random.Generator) -> Iterator[tuple]:
    """One row of Examples for each observed object."""
    try:
        observation = observe(scene.frame, seed=0)
    except FrameError:
        return
    if observation.support is None:
        return
    space = Space.of(observation)
    evidence = RayLookup(observation, space)
    T_world_table = scene.frame.camera.T_world_camera @ np.linalg.inv(observation.T_table_camera)
    for index, item in enumerate(observation.objects):
        if item.label not in scene.shapes:
            continue  # a wrong mask over several shapes has no truth
        visible = item.outline  # as the prior will be asked
        box = ObjectBox.around(visible, space.origin)
        around = evidence(box.lattice(), index)
        points = _hidden_points(box, item.points, space, rng)
        if len(points) < QUERIES:
            continue
        of_points = evidence(points, index)
        local = box.local(points)
        plan = Footprint.of(box, visible).at(box, local)
        body = Revolution.of(box, visible, partial(evidence, index=index))
        shape = scene.shapes[item.label]
        yield (
            box.scalars(),
            around.behind.astype(np.float16),
            around.seen,
            around.inside.clip(-FARTHEST_INSIDE, FARTHEST_INSIDE).astype(np.float16),
            box.surface_cells(visible),
            local,
            of_points.behind.astype(np.float32),
            of_points.seen,
            of_points.inside.astype(np.float32),
            plan[0].astype(np.float16),
            plan[1].astype(np.float16),
            body.channels(box, local).T.astype(np.float16),
            inside(shape, transform(T_world_table, points)),
            np.array(shape.family),
        )


def _hidden_points(box: ObjectBox, visible: np.ndarray, space: Space, rng: np.random.Generator) -> np.ndarray:
    """QUERIES points (Q, 3) in the box that no ray has reached; chosen by what is seen, never by the truth.

    Choosing by the truth would bend the probabilities.
    """
    cells = np.array(LATTICE)
    lattice = box.lattice()
    hidden = lattice[_unreached(space, lattice)]
    if len(hidden) == 0:
        return hidden
    anywhere = hidden[rng.integers(len(hidden), size=QUERIES)]
    anywhere = anywhere + rng.uniform(-0.5, 0.5, anywhere.shape) * (box.size / cells).mean()
    start = visible[rng.integers(len(visible), size=2 * (NEAR + BEHIND))]
    rays = shift_along_rays(space.origin, start, 1.0) - start
    share = rng.random((len(start), 1))
    near = start[: 2 * NEAR] + rays[: 2 * NEAR] * (NEAR_REACH * share[: 2 * NEAR])
    reach = max(REACH, REACH_SHARE * box.size[0])
    behind = start[2 * NEAR :] + rays[2 * NEAR :] * (reach * share[2 * NEAR :] ** 1.5)
    points = []
    for group, count in ((near, NEAR), (behind, BEHIND), (anywhere, QUERIES)):
        group = group.astype(np.float32)
        within = (np.abs(box.local(group)) < 1).all(axis=1) & _unreached(space, group)
        points.append(group[within][:count])
    # Near the box's middle is where it matters; the rest of the box fills up what is missing.
    return (
        np.concatenate(points)[:QUERIES] if sum(map(len, points)) >= QUERIES else np.empty((0, 3), np.float32)
    )


def _unreached(space: Space, points: np.ndarray) -> np.ndarray:
    behind = space.depth_behind(points)
    return ~(behind < LEAST_BEHIND) & (points[:, 2] > 0)
