"""Figures of the occupancy maps: the methods side by side, and ContraMap's three classes apart."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tools.reproduce.landscape import Landscape
from tools.reproduce.runs import save_figure


def draw_maps(out: Path, log: str, landscape: Landscape, methods: tuple[str, ...], seed: int) -> None:
    """Write out/<log>_methods.png and, where ContraMap ran, out/<log>_classes.png from the runs' maps."""
    from tools.reproduce.occupancy import TITLES, share_occupied

    maps = {}
    for method in methods:
        with np.load(out / "runs" / f"{log}-{method}-{seed}.npz") as stored:
            maps[method] = stored["probabilities"].astype(np.float32)
    occupancy = {TITLES[method]: share_occupied(drawn) for method, drawn in maps.items()}
    _row(out / f"{log}_methods.png", landscape, occupancy, "jet", "p(occupied) / (p(occupied) + p(free))")
    if "contramap" in maps:
        columns = ("free", "occupied", "uncertain")
        classes = {f"p({name})": maps["contramap"][..., i] for i, name in enumerate(columns)}
        _row(out / f"{log}_classes.png", landscape, classes, "viridis", "probability")


def _row(path: Path, landscape: Landscape, fields: dict[str, np.ndarray], colours: str, label: str) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    (left, bottom), (right, top) = landscape.low, landscape.high
    upright = (top - bottom) > (right - left)
    fields = dict(fields)
    width = 2.6 if upright else 4.0
    figure, axes = plt.subplots(
        1,
        len(fields),
        figsize=(width * len(fields) + 0.8, width * (top - bottom) / (right - left) + 0.5),
        layout="constrained",
        squeeze=False,
    )
    for axis, (title, field) in zip(axes[0], fields.items()):
        image = axis.imshow(
            field.T, origin="lower", extent=(left, right, bottom, top), vmin=0, vmax=1, cmap=colours
        )
        axis.set_title(title, fontsize=10)
        axis.set_xlabel("x [m]")
    axes[0, 0].set_ylabel("y [m]")
    figure.colorbar(image, ax=axes[0], label=label, fraction=0.03, pad=0.01)
    save_figure(figure, path)
    plt.close(figure)
