"""A map in tiles: each fitted alone on its points and those around it, blended where they overlap.

Knows points, tiles and the files of one output folder; must not know scans or who runs the tasks. A task
writes only files of its own, whole or not at all, so it can be run again, anywhere, in any order.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mapping.files import write_atomically
from mapping.hashed_hinges import filled_nodes
from mapping.label_doubt import labels_of
from mapping.multiscale import MultiscaleConfig, MultiscaleMap, Whole

Tile = tuple[int, int]
"""A tile's index along x and y."""
NOTHING = 255
"""Label of voxels that no point is near; their doubt and their p(uncertain) are 1."""
STEPS = 100
"""Local steps of a tile's fit: the loss that quasi-Newton steps of the map's own tolerance end at."""
VOXELS = (("label", "uint8", NOTHING), ("doubt", "float16", 1.0), ("uncertain", "float16", 1.0))
"""Arrays of the voxel store: name, type and what is there where nothing was written."""


@dataclass(frozen=True)
class TilePlan:
    """low: (3,) lower corner of the map [m]; counts: voxels along x, y, z; voxel [m]; side: voxels of a tile
    along x and y; overlap [m] by which a tile's points go beyond it."""

    low: tuple[float, float, float]
    counts: tuple[int, int, int]
    voxel: float
    side: int
    overlap: float

    def tiles(self) -> Iterator[Tile]:
        """Indices of the tiles along x and y."""
        across, along = (-(-n // self.side) for n in self.counts[:2])
        return ((i, j) for i in range(across) for j in range(along))

    def core(self, tile: Tile) -> tuple[np.ndarray, np.ndarray]:
        """Corners (2,) of a tile's own part [m]."""
        low = np.asarray(self.low[:2]) + self.side * self.voxel * np.asarray(tile)
        return low, low + self.side * self.voxel

    def within(self, tile: Tile, X: np.ndarray) -> np.ndarray:
        """(N,) whether points (N, 3) lie in the tile or its overlap."""
        low, high = self.core(tile)
        inside = (X[:, :2] >= low - self.overlap) & (X[:, :2] < high + self.overlap)
        return np.asarray(inside.all(axis=1))

    def weight(self, tile: Tile, X: np.ndarray) -> np.ndarray:
        """(N,) how much a tile's answer counts at points (N, 3): 1 well inside, 1/2 on its border, 0 beyond
        the overlap."""
        low, high = self.core(tile)
        from_low = (X[:, :2] - (low - self.overlap)) / (2 * self.overlap)
        from_high = ((high + self.overlap) - X[:, :2]) / (2 * self.overlap)
        return np.clip(np.minimum(from_low, from_high), 0, 1).prod(axis=1)

    def around(self, tile: Tile) -> list[Tile]:
        """The tile and its neighbours that are there."""
        every = set(self.tiles())
        near = [(tile[0] + a, tile[1] + b) for a in (-1, 0, 1) for b in (-1, 0, 1)]
        return [one for one in near if one in every]


@dataclass(frozen=True)
class Job:
    """What a worker needs for any tile: the folder with points.npy and labels.npy, plan, settings, seed."""

    folder: Path
    plan: TilePlan
    config: MultiscaleConfig
    whole: Whole
    seed: int

    def map_file(self, tile: Tile) -> Path:
        """The tile's fitted map; empty where too few points are."""
        return self.folder / "tiles" / f"{tile[0]:04d}_{tile[1]:04d}.npz"

    def done_file(self, tile: Tile) -> Path:
        """Written after the tile's chunks are."""
        return self.folder / "tiles" / f"{tile[0]:04d}_{tile[1]:04d}.done"


def fit_tile(job: Job, tile: Tile) -> None:
    """Fit one tile's map and write it, unless that was done."""
    path = job.map_file(tile)
    if path.is_file():
        return
    points = np.load(job.folder / "points.npy", mmap_mode="r")
    rows = np.flatnonzero(job.plan.within(tile, points))
    if not len(rows):
        write_atomically(path, b"")
        return
    y = np.load(job.folder / "labels.npy", mmap_mode="r")[rows].astype(np.int64)
    rng = np.random.default_rng(job.seed)  # the same for every tile: so are the noise samples
    model = MultiscaleMap(job.config).fit(points[rows], y, len(job.whole.counts), rng, job.whole)
    model.save(path)


def ask_tiles(
    job: Job,
    tiles: list[Tile],
    X: np.ndarray,
    load: Callable[[Tile], MultiscaleMap] | None = None,
) -> np.ndarray:
    """Blended class probabilities (N, C + 1) at points (N, 3); uncertain where no tile has a map.

    load: the map of a tile that has one, by default read from its file.
    """
    load = load or (lambda tile: MultiscaleMap(job.config).load(job.map_file(tile)))
    classes = len(job.whole.counts)
    total, weights = np.zeros((len(X), classes + 1)), np.zeros(len(X))
    for tile in tiles:
        weight = job.plan.weight(tile, X)
        rows = np.flatnonzero(weight > 0)
        if len(rows) and job.map_file(tile).stat().st_size:
            total[rows] += weight[rows, None] * load(tile).predict_proba(X[rows])
            weights[rows] += weight[rows]
    unknown = weights == 0
    total[unknown, -1] = weights[unknown] = 1
    return (total / weights[:, None]).astype(np.float32)


def write_tile(job: Job, tile: Tile) -> None:
    """Ask the tile's voxels near points and write its own chunks, unless that was done."""
    if job.done_file(tile).is_file():
        return
    import zarr

    plan = job.plan
    start = np.array([plan.side * tile[0], plan.side * tile[1], 0])
    stop = np.minimum(start + np.array([plan.side, plan.side, plan.counts[2]]), plan.counts)
    points = np.load(job.folder / "points.npy", mmap_mode="r")
    near = np.asarray(points[plan.within(tile, points)], np.float64)
    window = tuple(slice(a, b) for a, b in zip(start, stop))
    label = np.full(stop - start, NOTHING, np.uint8)
    doubt, uncertain = np.ones((2, *(stop - start)), np.float16)
    if len(near):
        cell = filled_nodes(near - np.asarray(plan.low) - plan.voxel / 2, plan.voxel)
        steps = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3), -1).reshape(-1, 3)
        cell = np.unique((cell[:, None] + steps).reshape(-1, 3), axis=0)
        cell = cell[((cell >= start) & (cell < stop)).all(axis=1)]
        if len(cell):
            answer = ask_tiles(job, plan.around(tile), np.asarray(plan.low) + (cell + 0.5) * plan.voxel)
            place = tuple((cell - start).T)
            label[place], doubt[place], uncertain[place] = labels_of(answer)
    store: Any = zarr.open_group(job.folder / "voxels.zarr", mode="r+")
    for name, values in (("label", label), ("doubt", doubt), ("uncertain", uncertain)):
        store[name][window] = values
    write_atomically(job.done_file(tile), b"")


def create_store(job: Job, names: tuple[str, ...]) -> None:
    """An empty Zarr store with a chunk for each tile, unless it is there."""
    import zarr

    folder = job.folder / "voxels.zarr"
    if (folder / VOXELS[-1][0] / "zarr.json").is_file():
        return
    store = zarr.open_group(folder, mode="w")
    store.attrs.update(
        {
            "classes": list(names),
            "nothing": NOTHING,
            "origin_m": list(job.plan.low),
            "voxel_m": job.plan.voxel,
        }
    )
    chunks = (job.plan.side, job.plan.side, job.plan.counts[2])
    for name, kind, fill in VOXELS:
        store.create_array(name, shape=job.plan.counts, chunks=chunks, dtype=kind, fill_value=fill)


def fitted_so(config: MultiscaleConfig, steps: int, tolerance: float | None) -> MultiscaleConfig:
    """Settings whose fits take so many local steps, which give tiles one tile's probabilities; or, with a
    tolerance, quasi-Newton ones until a step lowers the mean loss [nats] by less."""
    if tolerance is None:
        return replace(config, local_steps=steps)
    # Long fits are worth a longer memory.
    memory = 16 if tolerance < config.fit.tolerance else config.fit.memory
    fit = replace(config.fit, tolerance=tolerance, memory=memory, max_iterations=5000)
    return replace(config, fit=fit, local_steps=0)


def plan_tiles(X: np.ndarray, voxel: float, tile: float, overlap: float) -> TilePlan:
    """Tiles of about `tile` [m] over points X (N, 3), with a rim of two voxels around them."""
    low = np.floor(X.min(axis=0) / voxel - 2) * voxel
    counts = np.ceil((X.max(axis=0) - low) / voxel + 2).astype(int)
    side = max(1, round(tile / voxel))
    return TilePlan(
        tuple(float(v) for v in low),  # type: ignore[arg-type]
        tuple(int(n) for n in counts),  # type: ignore[arg-type]
        voxel,
        side,
        overlap,
    )
