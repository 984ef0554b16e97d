"""How a recording opens in the rerun viewer; stored in the same file as the data."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

FIELD = 2.2
"""Distance of the first viewpoint from the objects, in diameters of what is shown."""
SIDE = 65.0
"""The first view is this far round the objects from the sensor [degrees]: from its own place all is seen."""
SLOPE = 30.0
"""How far the first view looks down [degrees]."""
GUIDES = ("/world/boxes/**", "/world/axes", "/world/table/axes")


def run_blueprint(eye: np.ndarray, target: np.ndarray, up: np.ndarray) -> Any:
    """Four 3D tabs over the colour bar, the images, the fit and a summary.

    eye, target: (3,) [m] first viewpoint in the table frame; up: (3,).
    """
    import rerun.blueprint as rrb

    def space(name: str, *contents: str) -> Any:
        return _space(name, ("/world/camera", *contents), eye, target, up)

    spaces = rrb.Tabs(
        space("Uncertainty", "/world/uncertainty/**", "/world/cloud/background", *GUIDES),
        space("Objects and truth", "/world/meshes/**", "/world/truth/**", *GUIDES),
        space("Samples and hinges", "/world/table/**"),
        space("Slice", "/world/slice", "/world/meshes/**"),
        active_tab=0,
    )
    images = rrb.Horizontal(
        rrb.Spatial2DView(
            origin="/world/camera", contents=["/world/camera/rgb", "/world/camera/labels"], name="Labels"
        ),
        rrb.Spatial2DView(origin="/world/camera", contents=["/world/camera/depth"], name="Depth"),
    )
    plots = rrb.Horizontal(
        rrb.TimeSeriesView(
            origin="/fit", name="Fit loss per step", plot_legend=rrb.PlotLegend(visible=False)
        ),
        rrb.BarChartView(origin="/timings", name="Stages [ms]", plot_legend=rrb.PlotLegend(visible=True)),
    )
    summary = rrb.TextDocumentView(origin="/summary", name="Summary")
    return rrb.Blueprint(
        rrb.Horizontal(
            _over_colour_bar(spaces),
            rrb.Vertical(images, plots, summary, row_shares=[3, 2, 3]),
            column_shares=[3, 2],
        ),
        rrb.TimePanel(timeline="step", state="collapsed", play_state="paused"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
    )


def growing_blueprint(eye: np.ndarray, target: np.ndarray, up: np.ndarray) -> Any:
    """Meshes in two colourings over the colour bar, the camera's image, p(uncertain) frame by frame and a
    summary, with the timeline open, for maps that grow.

    eye, target: (3,) [m] first viewpoint in the table frame; up: (3,).
    """
    import rerun.blueprint as rrb

    shown = ("/world/camera", "/world/camera/rgb", *GUIDES)
    spaces = rrb.Tabs(
        _space("Uncertainty", ("/world/uncertainty/**", *shown), eye, target, up),
        _space("Objects", ("/world/meshes/**", *shown), eye, target, up),
        active_tab=0,
    )
    image = rrb.Spatial2DView(origin="/world/camera", contents=["/world/camera/rgb"], name="Frame")
    plot = rrb.TimeSeriesView(
        origin="/progress", name="Mean p(uncertain)", plot_legend=rrb.PlotLegend(visible=True)
    )
    summary = rrb.TextDocumentView(origin="/summary", name="Summary")
    return rrb.Blueprint(
        rrb.Horizontal(_over_colour_bar(spaces), rrb.Vertical(image, plot, summary), column_shares=[3, 2]),
        rrb.TimePanel(timeline="frame", state="expanded", play_state="paused"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
    )


def mesh_blueprint(eye: np.ndarray, target: np.ndarray, up: np.ndarray) -> Any:
    """Meshes in two colourings over the colour bar, and a summary, for results whose run was not recorded.

    eye, target: (3,) [m] first viewpoint in the table frame; up: (3,).
    """
    import rerun.blueprint as rrb

    spaces = rrb.Tabs(
        _space("Uncertainty", ("/world/uncertainty/**", *GUIDES), eye, target, up),
        _space("Objects", ("/world/meshes/**", *GUIDES), eye, target, up),
        active_tab=0,
    )
    plots = rrb.BarChartView(origin="/timings", name="Stages [ms]", plot_legend=rrb.PlotLegend(visible=True))
    summary = rrb.TextDocumentView(origin="/summary", name="Summary")
    return rrb.Blueprint(
        rrb.Horizontal(_over_colour_bar(spaces), rrb.Vertical(plots, summary), column_shares=[3, 1]),
        collapse_panels=True,
    )


def first_view(
    low: np.ndarray, high: np.ndarray, axes: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Eye and target (3,) [m] that show the box low..high (3,) from the side, where seen and hidden parts
    both show, and up (3,).

    axes: (3, 3), its rows the directions away from the sensor, to its left, and up.
    """
    away, left, up = axes
    target = (low + high) / 2
    distance = FIELD * float(np.linalg.norm(high - low)) / 2 + 0.15
    side, slope = np.radians(SIDE), np.radians(SLOPE)
    heading = np.cos(side) * away + np.sin(side) * left
    return target + distance * (np.sin(slope) * up - np.cos(slope) * heading), target, up


def _space(name: str, contents: Sequence[str], eye: np.ndarray, target: np.ndarray, up: np.ndarray) -> Any:
    import rerun.blueprint as rrb

    return rrb.Spatial3DView(
        origin="/world/table",
        contents=list(contents),
        name=name,
        eye_controls=rrb.EyeControls3D(position=eye, look_target=target, eye_up=up),
        line_grid=False,
    )


def _over_colour_bar(spaces: Any) -> Any:
    import rerun.blueprint as rrb

    bar = rrb.Spatial2DView(origin="/legend/uncertainty", name="Colours of p(uncertain)")
    return rrb.Vertical(spaces, bar, row_shares=[9, 1])
