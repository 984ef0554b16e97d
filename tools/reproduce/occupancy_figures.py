"""Figures of the occupancy maps: the methods side by side, and ContraMap's three classes apart."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tools.reproduce.landscape import Landscape
from tools.reproduce.runs import save_figure


def draw_maps(out: Path, log: str, landscape: Landscape, methods: tuple[str, ...], seed: int) -> None:
    """Write out/<log>_methods.png and, where ContraMap ran, out/<log>_classes.png from the runs' maps."""
    from tools.occupancy.fit import share_occupied
    from tools.reproduce.occupancy_methods import TITLES

    maps, box = {}, (landscape.low, landscape.high)
    for method in methods:
        with np.load(out / "runs" / f"{log}-{method}-{seed}.npz") as stored:
            maps[method] = stored["probabilities"].astype(np.float32)
    occupancy = {TITLES[method]: share_occupied(drawn) for method, drawn in maps.items()}
    draw_panels(out / f"{log}_methods.png", box, occupancy, "jet", "p(occupied | not uncertain)")
    if "contramap" in maps:
        columns = ("free", "occupied", "uncertain")
        classes = {f"p({name})": maps["contramap"][..., i] for i, name in enumerate(columns)}
        draw_panels(out / f"{log}_classes.png", box, classes, "viridis", "probability")


def draw_panels(
    path: Path,
    box: tuple[Sequence[float] | np.ndarray, Sequence[float] | np.ndarray],
    fields: dict[str, np.ndarray],
    colours: str,
    label: str,
) -> None:
    """Write fields (A, B) over a box (low, high corners) [m] side by side, or one above the other."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    (left, bottom), (right, top) = box
    shape = (top - bottom) / (right - left)
    stacked = shape < 0.6  # wide maps go one above the other
    rows, columns = (len(fields), 1) if stacked else (1, len(fields))
    width = 8.0 if stacked else 2.6 if shape > 1 else 4.0
    size = (width * columns + 0.8, (width * shape + 0.5) * rows)
    figure, axes = plt.subplots(rows, columns, figsize=size, layout="constrained", squeeze=False)
    for axis, (title, field) in zip(axes.flat, fields.items()):
        image = axis.imshow(
            field.T, origin="lower", extent=(left, right, bottom, top), vmin=0, vmax=1, cmap=colours
        )
        axis.set_title(title, fontsize=10)
    for axis in axes[-1]:
        axis.set_xlabel("x [m]")
    for axis in axes[:, 0]:
        axis.set_ylabel("y [m]")
    figure.colorbar(image, ax=axes, label=label, fraction=0.03, pad=0.01)
    save_figure(figure, path)
    plt.close(figure)
