"""Where a laser log's map lies and how fine its hinge points are, found from the log's own points.

Knows labelled points in the plane; must not know files or pictures.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from mapping.contramap import ContraMap
from mapping.hinges import lattice_near_points
from perception.laser_files import longest_return
from perception.lidar import BeamConfig, LaserLog, occupancy_samples, split_scans
from tools.evaluation.statistics import auroc
from tools.occupancy.fit import OCCUPIED, OccupancyMapConfig, fit_occupancy, occupancy_of


@dataclass(frozen=True)
class LandscapeConfig:
    """How the landscape is found, and the map it is for."""

    beams: BeamConfig = field(default_factory=BeamConfig)
    """How beams become labelled points; range_max also bounds what `longest_return` finds."""
    map: OccupancyMapConfig = field(default_factory=OccupancyMapConfig)
    """The map's settings."""
    spacings: tuple[float, ...] = (0.25, 0.35, 0.5, 0.7)
    """Spacings of the hinge points that are tried [m], fine to coarse, where the room is of common size."""
    common_range: float = 4.0
    """Median range [m] of a room of common size; spacings grow and shrink with its square root."""
    rim: float = 2.0
    """Hinge points lie within this many spacings of a sample: noise there pulls the map back to uncertain."""
    held_out: float = 0.1
    """Share of the scans held out to choose the spacing, and again to judge the map."""


@dataclass(frozen=True)
class Samples:
    """Labelled points X (N, 2) [m], y (N,) FREE or OCCUPIED, of some scans."""

    X: np.ndarray
    y: np.ndarray


def clean_beams(log: LaserLog, config: LandscapeConfig) -> LandscapeConfig:
    """The same settings with `range_max` below this log's "no return" reading."""
    longest = min(longest_return(log), config.beams.range_max)
    return replace(config, beams=replace(config.beams, range_max=longest))


def samples_of(
    log: LaserLog, scans: np.ndarray, config: LandscapeConfig, rng: np.random.Generator
) -> Samples:
    """Labelled points of some scans (indices)."""
    return Samples(*occupancy_samples(log, rng, scans, config.beams))


def fit_spacing(
    samples: Samples, spacing: float, config: LandscapeConfig, rng: np.random.Generator
) -> ContraMap:
    """A map of the samples with hinge points `spacing` [m] apart, only where samples are near."""
    hinges = lattice_near_points(samples.X, config.rim * spacing, spacing)
    # As many noise samples as data, spread evenly over the cells of the hinge points.
    cell = rng.integers(0, len(hinges), len(samples.X))
    noise = hinges[cell] + rng.uniform(-0.5, 0.5, (len(cell), 2)) * spacing
    gamma = config.map.kernel_width / spacing**2
    return fit_occupancy(samples.X, samples.y, noise, hinges, gamma, config.map)


def held_out_auc(model: ContraMap, samples: Samples) -> float:
    """AUC of p(occupied | not uncertain) on samples that the map has not seen."""
    return auroc(occupancy_of(model, samples.X), samples.y == OCCUPIED)


def find_spacing(
    log: LaserLog,
    scans: np.ndarray,
    config: LandscapeConfig,
    rng: np.random.Generator,
    progress: Callable[[], object] = lambda: None,
) -> dict[float, float]:
    """AUC on held-out scans (a share of `scans`) for every spacing tried [m]; the largest one chooses."""
    train, check = split_scans(len(scans), rng, config.held_out)
    fitted, judged = (samples_of(log, scans[part], config, rng) for part in (train, check))
    scores = {}
    for spacing in spacings_for(log, config):
        scores[spacing] = held_out_auc(fit_spacing(fitted, spacing, config, rng), judged)
        progress()
    return scores


def spacings_for(log: LaserLog, config: LandscapeConfig) -> list[float]:
    """Spacings worth trying [m]: a hall wants coarser hinge points than a flat."""
    seen = log.ranges[(log.ranges > 0) & (log.ranges <= config.beams.range_max)]
    scale = float(np.sqrt(np.median(seen) / config.common_range))
    return [float(f"{scale * spacing:.2g}") for spacing in config.spacings]
