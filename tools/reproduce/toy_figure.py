"""The paper's toy figure: rows are sets, columns are methods, shading is uncertainty."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sim_scenes.toy2d import ToySet
from tools.reproduce.runs import save_figure


def draw_toy(
    path: Path,
    toys: dict[str, ToySet],
    methods: tuple[str, ...],
    fields: dict[tuple[str, str], np.ndarray],
    grid: int,
) -> None:
    """Write the figure; fields: (set, method) -> (grid^2,) uncertainty, shaded from least to largest."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    from tools.reproduce.toy_methods import TITLES

    figure, axes = plt.subplots(
        len(toys),
        len(methods),
        figsize=(2.3 * len(methods), 1.75 * len(toys)),
        layout="constrained",
        squeeze=False,
    )
    for row, (name, toy) in zip(axes, toys.items()):
        extent = (toy.low[0], toy.high[0], toy.low[1], toy.high[1])
        for axis, method in zip(row, methods):
            shade = fields[name, method].reshape(grid, grid).T
            axis.imshow(shade, origin="lower", extent=extent, cmap="viridis", aspect="auto")
            for label, colour in ((0, "orange"), (1, "magenta")):
                axis.plot(*toy.X[toy.y == label].T, ".", color=colour, markersize=1, alpha=0.6)
            axis.plot(*toy.X_ood.T, ".", color="red", markersize=1, alpha=0.6)
            axis.set(xticks=[], yticks=[], xlim=extent[:2], ylim=extent[2:])
            if axis in axes[0]:
                axis.set_title(TITLES[method], fontsize=10)
        row[0].set_ylabel(name.replace("_", " "), fontsize=10)
    save_figure(figure, path)
    plt.close(figure)
