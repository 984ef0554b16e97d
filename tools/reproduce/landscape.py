"""The Radish logs as the paper maps them: which area, how many hinge points, how a seed splits the scans."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mapping.errors import DataError
from perception.lidar import BeamConfig, LaserLog, load_carmen, occupancy_samples, split_scans


@dataclass(frozen=True)
class Landscape:
    """The rectangle that is mapped, and its even grid of hinge points.

    low, high: (x, y) corners [m]. cells: hinge points along x and y; a point lies in the middle of its cell.
    """

    low: tuple[float, float]
    high: tuple[float, float]
    cells: tuple[int, int]

    @property
    def spacing(self) -> np.ndarray:
        """(2,) distance of neighbouring hinge points along x and y [m]."""
        return np.subtract(self.high, self.low) / self.cells

    @property
    def hinges(self) -> np.ndarray:
        """(H, 2) hinge points [m]."""
        axes = [low + step * (np.arange(n) + 0.5) for low, step, n in zip(self.low, self.spacing, self.cells)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)

    def gamma(self, width: float) -> float:
        """Kernel width [1/m^2] that keeps gamma times the cell's area at `width`."""
        return width / float(self.spacing.prod())

    def query_axes(self, per_hinge: int) -> tuple[np.ndarray, np.ndarray]:
        """x and y coordinates [m] of the map's query points, `per_hinge` a hinge point along each axis."""
        x, y = (
            low + step / per_hinge * (np.arange(n * per_hinge) + 0.5)
            for low, step, n in zip(self.low, self.spacing, self.cells)
        )
        return x, y

    def inside(self, X: np.ndarray) -> np.ndarray:
        """(N,) whether the points (N, 2) lie in the rectangle."""
        low, high = np.array(self.low), np.array(self.high)
        return np.all((low <= X) & (high >= X), axis=1)

    def with_hinges(self, count: int) -> Landscape:
        """The same rectangle with about `count` hinge points on cells that are nearly square."""
        width, height = np.subtract(self.high, self.low)
        across = max(1, round(float(np.sqrt(count * width / height))))
        return Landscape(self.low, self.high, (across, max(1, round(count / across))))


LANDSCAPES = {
    "belgioioso": Landscape((-13, -41), (22, 52), (56, 150)),
    "edmonton": Landscape((-62, -38), (32, 57), (88, 100)),
    "fhw": Landscape((-5, -31), (22, 57), (44, 135)),
    "intel": Landscape((-20, -25), (20, 10), (80, 70)),
    "mexico": Landscape((-93, -37), (10, 23), (125, 60)),
    "aces": Landscape((-27, -48), (31, 8), (60, 65)),
    "orebro": Landscape((-42, -46), (46, 46), (70, 80)),
    "seattle": Landscape((-52, -10), (3, 8), (84, 25)),
}
"""Hinge counts are the paper's (5600 on Intel is 0.5 m); rectangles hold 99 % of a log's points. The last
three logs are those that the paper's table left out."""

PAPER_LOGS = tuple(LANDSCAPES)[:5]
"""The logs of the paper's table."""

FILE_NAMES = {"mexico": "acapulco"}
"""Logs whose file has another name: Mexico is the convention centre of Acapulco."""


def load_log(folder: Path, name: str) -> LaserLog:
    """The named log in `folder`. Raises DataError when it is not there."""
    stem = FILE_NAMES.get(name, name)
    for ending in ("-corrected.log.gz", "-corrected.log", ".gfs.log", ".log.gz", ".log"):
        if (folder / (stem + ending)).is_file():
            return load_carmen(folder / (stem + ending))
    raise DataError(f"{folder}: no {stem}-corrected.log.gz; --data must name a folder of CARMEN logs")


@dataclass(frozen=True)
class Split:
    """Labelled points of one seed: training and test points (N, 2) [m] and labels (N,), and the noise."""

    X: np.ndarray
    y: np.ndarray
    X_test: np.ndarray
    y_test: np.ndarray
    noise: np.ndarray
    outside: int
    """Points left out because they lie outside the landscape."""


def split_log(
    log: LaserLog, landscape: Landscape, beams: BeamConfig, run: int, rng: np.random.Generator
) -> Split:
    """Nine tenths of the scans train, the rest test; there are as many noise points as training points."""
    parts, outside = [], 0
    for scans in split_scans(len(log.poses), rng, run=run):
        X, y = occupancy_samples(log, rng, scans, beams)
        inside = landscape.inside(X)
        outside += int((~inside).sum())
        parts.append((X[inside], y[inside]))
    (X, y), (X_test, y_test) = parts
    noise = rng.uniform(landscape.low, landscape.high, size=X.shape)
    return Split(X, y, X_test, y_test, noise, outside)
