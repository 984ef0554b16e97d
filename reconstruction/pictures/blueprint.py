"""How a recording opens in the rerun viewer; stored in the same file as the data."""

from __future__ import annotations

from typing import Any

import numpy as np

FIELD = 2.2
"""Distance of the first viewpoint from the objects, in diameters of what is shown."""


def run_blueprint(eye: np.ndarray, target: np.ndarray, up: np.ndarray) -> Any:
    """Four 3D tabs, the images, the fit and a summary.

    eye, target: (3,) [m] first viewpoint in the table frame; up: (3,).
    """
    import rerun.blueprint as rrb

    def space(name: str, *contents: str) -> Any:
        return rrb.Spatial3DView(
            origin="/world/table",
            contents=["/world/camera", *contents],
            name=name,
            eye_controls=rrb.EyeControls3D(position=eye, look_target=target, eye_up=up),
            line_grid=False,
        )

    spaces = rrb.Tabs(
        space("Uncertainty", "/world/uncertainty/**", "/world/cloud/background"),
        space("Objects and truth", "/world/meshes/**", "/world/truth/**"),
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
        rrb.BarChartView(
            origin="/timings", name="Stages [ms], see summary", plot_legend=rrb.PlotLegend(visible=False)
        ),
    )
    summary = rrb.TextDocumentView(origin="/summary", name="Summary")
    return rrb.Blueprint(
        rrb.Horizontal(
            spaces, rrb.Vertical(images, plots, summary, row_shares=[3, 2, 3]), column_shares=[3, 2]
        ),
        rrb.TimePanel(timeline="step", state="collapsed", play_state="paused"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
    )


def mesh_blueprint() -> Any:
    """Meshes in two colourings and a summary, for results without a recording of the run."""
    import rerun.blueprint as rrb

    def space(name: str, contents: str) -> Any:
        return rrb.Spatial3DView(origin="/world/table", contents=[contents], name=name, line_grid=False)

    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Tabs(
                space("Uncertainty", "/world/uncertainty/**"),
                space("Objects", "/world/meshes/**"),
                active_tab=0,
            ),
            rrb.TextDocumentView(origin="/summary", name="Summary"),
            column_shares=[3, 1],
        ),
        collapse_panels=True,
    )


def first_view(
    low: np.ndarray, high: np.ndarray, away: np.ndarray, up: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Eye and target (3,) [m] that show the box low..high (3,) from the sensor's side, 35 degrees above it.

    away: (3,) horizontal direction from the sensor to the objects; up: (3,).
    """
    target = (low + high) / 2
    distance = FIELD * float(np.linalg.norm(high - low)) / 2 + 0.15
    slope = np.radians(35)
    return target + distance * (np.sin(slope) * up - np.cos(slope) * away), target
