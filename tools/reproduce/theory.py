"""The paper's Section IV checked on its own terms: p(uncertain) against the Bayes posterior and the distance.

The stylised mixture: data from an isotropic Gaussian, whose density falls with the distance d(x), and
uniform noise over a square. The Bayes posterior of the noise is then known in closed form.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from mapping.config import FitConfig, MapConfig
from mapping.contramap import ContraMap
from tools.evaluation.statistics import spearman
from tools.options import write_json
from tools.reproduce.runs import save_figure
from tools.reproduce.toy import expected_distance


@dataclass(frozen=True)
class TheoryConfig:
    """The mixture and the map that learns it."""

    data_points: int = 20_000
    """Draws of the Gaussian; class 1 with probability sigmoid(2 x), else class 0."""
    noise_points: int = 20_000
    """Draws of the uniform noise."""
    deviation: float = 1.0
    """Standard deviation of the Gaussian along each axis."""
    half_width: float = 3.0
    """The noise covers [-half_width, half_width] along each axis."""
    query_half_width: float = 2.5
    """Queries stay this near the origin along each axis: farther out the noise's border shows."""
    grid: int = 61
    """Query points along each axis."""
    map: MapConfig = field(
        default_factory=lambda: MapConfig(gamma=0.25, hinge_spacing=1.0, l2=1e-5, fit=FitConfig(500, 1e-6))
    )
    """The map."""


@dataclass(frozen=True)
class TheoryResult:
    """Fields over the grid, each (grid^2,), y fastest."""

    points: np.ndarray  # (grid^2, 2)
    uncertain: np.ndarray
    posterior: np.ndarray
    distance: np.ndarray

    def figures(self) -> dict[str, float]:
        """Rank correlations of p(uncertain), and its mean absolute error against the Bayes posterior."""
        return {
            "spearman_posterior": spearman(self.uncertain, self.posterior),
            "spearman_distance": spearman(self.uncertain, self.distance),
            "mean_absolute_error": float(np.abs(self.uncertain - self.posterior).mean()),
        }


def check_theory(rng: np.random.Generator, config: TheoryConfig | None = None) -> TheoryResult:
    """Fit the map to a draw of the mixture; compare p(uncertain) with the posterior and with d(x)."""
    config = config or TheoryConfig()
    half = config.half_width
    data = rng.normal(scale=config.deviation, size=(config.data_points, 2))
    noise = rng.uniform(-half, half, size=(config.noise_points, 2))
    classes = rng.uniform(size=len(data)) < 1.0 / (1.0 + np.exp(-2.0 * data[:, 0]))
    labels = np.concatenate([classes.astype(int), np.full(len(noise), 2)])
    model = ContraMap(config.map).fit(np.concatenate([data, noise]), labels)
    axis = np.linspace(-config.query_half_width, config.query_half_width, config.grid)
    points = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    variance = config.deviation**2
    density = np.exp(-0.5 * (points**2).sum(axis=1) / variance) / (2.0 * np.pi * variance)
    from_data = config.data_points * density
    from_noise = config.noise_points / (2.0 * half) ** 2
    sample = rng.normal(scale=config.deviation, size=(4000, 2))
    return TheoryResult(
        points=points,
        uncertain=model.predict_proba(points)[:, -1].astype(np.float64),
        posterior=from_noise / (from_data + from_noise),
        distance=expected_distance(points, sample),
    )


def run_theory(out: Path, seed: int = 0, config: TheoryConfig | None = None) -> dict[str, float]:
    """Write out/theory.png and out/theory.json; returns the rank correlations."""
    result = check_theory(np.random.default_rng(seed), config)
    figures = result.figures()
    write_json(figures, out / "theory.json")
    _draw(out / "theory.png", result)
    return figures


def _draw(path: Path, result: TheoryResult) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (map_axis, posterior_axis, distance_axis) = plt.subplots(
        1, 3, figsize=(12, 3.6), layout="constrained"
    )
    count = round(len(result.points) ** 0.5)
    low, high = result.points.min(), result.points.max()
    image = map_axis.imshow(
        result.uncertain.reshape(count, count).T,
        origin="lower",
        extent=(low, high, low, high),
        vmin=0,
        vmax=1,
    )
    map_axis.set(title="p(uncertain), learned", xlabel="x", ylabel="y")
    figure.colorbar(image, ax=map_axis, fraction=0.046)
    figures = result.figures()
    posterior_axis.plot([0, 1], [0, 1], color="grey", linewidth=1)
    posterior_axis.plot(result.posterior, result.uncertain, ".", markersize=2)
    posterior_axis.set(xlabel="Bayes posterior of the noise", ylabel="p(uncertain)")
    posterior_axis.set_title(f"Spearman {figures['spearman_posterior']:.4f}")
    order = np.argsort(result.distance)
    distance_axis.plot(result.distance[order], result.posterior[order], color="grey", label="Bayes posterior")
    distance_axis.plot(result.distance, result.uncertain, ".", markersize=2, label="p(uncertain)")
    distance_axis.set(xlabel="expected distance d(x)", title=f"Spearman {figures['spearman_distance']:.4f}")
    distance_axis.legend()
    save_figure(figure, path)
    plt.close(figure)
