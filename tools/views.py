"""How much further views are worth: the map of 1, 2, 3 and more views beside TSDF fusion of the same views
and the union of single-view meshes.

`python -m tools.views SCENES --views 1 2 3 5 --out docs/results/views.md` writes the table; scenes come from
`contramap scenes SCENES --views 5`. Objects that show at least 200 pixels in the first view are judged, so
that every row judges the same ones.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import trimesh
import tyro

from mapping.errors import ConfigError
from perception.camera import Camera, invert_rigid
from perception.frame import Frame
from tools.evaluation.unions import SAMPLES, iou_of_union, surface_of_union
from tools.exit_code import exit_code

if TYPE_CHECKING:
    from reconstruction.result import Reconstruction
    from reconstruction.solid import Solid

LEAST_PIXELS = 200
"""Objects that show fewer pixels in the first view are not judged."""
CARD_SPACING = 0.01
"""Voxels on which p(uncertain) is to tell occluded from seen space [m]."""
CARD_RADIUS = 0.15
"""They lie within this distance of true object centres [m]."""
METRICS = ("chamfer_mm", "fscore_5mm", "iou_2_5mm", "agreement", "uncertainty", "occlusion_auroc", "seconds")
UNCERTAIN_NULL = float("nan")


@dataclass(frozen=True)
class ManyViews:
    """A scene: its frames, and the true shapes [m, world frame] of the judged objects by label."""

    name: str
    frames: list[Frame]
    solids: dict[int, Solid]
    kept: dict[int, Reconstruction] = field(default_factory=dict)

    def alone(self, frame: Frame) -> Reconstruction:
        """The map of one frame, made once."""
        from reconstruction import reconstruct

        if id(frame) not in self.kept:
            self.kept[id(frame)] = reconstruct(frame)
        return self.kept[id(frame)]


@dataclass(frozen=True)
class Answer:
    """One object as a method has it. parts: closed meshes [m, world frame], whose union it is."""

    parts: tuple[trimesh.Trimesh, ...]
    uncertainty: float = UNCERTAIN_NULL


def main(
    scenes: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")],
    views: tuple[int, ...] = (1, 2, 3, 5),
    methods: tuple[str, ...] = ("contramap", "tsdf", "union"),
    wrong: Annotated[float, tyro.conf.arg(metavar="M")] = 0.02,
    limit: int = 100,
    ycb: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    json: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
) -> None:
    """Judge maps of several views.

    Args:
        scenes: Scenes with truth and views, as `contramap scenes --views V` makes them.
        views: Numbers of views.
        methods: contramap, tsdf (masked depth fused by Open3D), union (of single-view meshes).
        wrong: Also map the most views with one pose wrong by this much, and without that view; 0: do not [m].
        limit: Scenes judged, at most.
        ycb: Folder of YCB scans, for scenes made of them.
        out: Also write the table to this Markdown file.
        json: Also write the figures to this file.
    """
    from tqdm import tqdm

    from mapping.files import write_atomically
    from sim_scenes.truth import TRUTH_FILE
    from tools.options import write_json

    unknown = sorted({*methods} - {*METHODS})
    if unknown or not views or min(views) < 1:
        raise ConfigError(
            f"--methods are {', '.join(METHODS)}, --views are 1 or more; got {unknown or views}"
        )
    folders = sorted(path.parent for path in Path(scenes).glob(f"*/{TRUTH_FILE}"))[:limit]
    if not folders:
        raise ConfigError(
            f"{scenes}: no scenes here; `contramap scenes {scenes} --views {max(views)}` makes some"
        )
    rows: list[dict[str, Any]] = []
    for folder in tqdm(folders, desc="scenes"):
        scene = load_scene(folder, max(views), ycb)
        for method in methods:
            rows += [
                {"method": method, "views": str(count), **row}
                for count in sorted(views)
                for row in judge(scene, method, scene.frames[:count])
            ]
        if wrong and max(views) > 2:
            rows += wrong_pose(scene, wrong)
    text = table(rows, len(folders))
    print(text)
    if out is not None:
        write_atomically(out, (HEAD.format(wrong=1e3 * wrong) + text).encode())
    if json is not None:
        write_json({"scenes": len(folders), "rows": rows}, json)


def load_scene(folder: Path, count: int, ycb: Path | None = None) -> ManyViews:
    """A scene folder's first `count` views and its truth. Raises ConfigError when it has fewer."""
    from perception.frame_io import load_frame
    from reconstruction.solid import Solid
    from sim_scenes.truth import load_truth

    truth = load_truth(folder, ycb)
    if len(truth.views) < count:
        raise ConfigError(f"{folder}: has {len(truth.views)} views; make scenes with --views {count}")
    frames = [load_frame(view) for view in truth.views[:count]]
    labels = frames[0].labels
    assert labels is not None
    pixels = np.bincount(labels.ravel(), minlength=max(truth.meshes) + 1)
    judged = {label: Solid(mesh) for label, mesh in truth.meshes.items() if pixels[label] >= LEAST_PIXELS}
    return ManyViews(folder.name, frames, judged)


def judge(scene: ManyViews, method: str, frames: Sequence[Frame]) -> list[dict[str, Any]]:
    """One row of figures for each judged object; one that got no mesh has IoU and F-score 0."""
    from time import perf_counter

    from reconstruction.metrics import (
        chamfer_of_distances,
        fscore_of_distances,
        mutual_distances,
        sample_surface,
    )
    from reconstruction.surface.agreement import agreement_with_depth, together

    start = perf_counter()
    answers, auroc = METHODS[method](scene, frames)
    seconds = perf_counter() - start
    rows = []
    for label, true in scene.solids.items():
        row: dict[str, Any] = {"scene": scene.name, "label": label, "seconds": seconds}
        row |= {"occlusion_auroc": auroc, "fscore_5mm": 0.0, "iou_2_5mm": 0.0}
        answer = answers.get(label)
        if answer is not None:
            rng = np.random.default_rng(label)
            points = surface_of_union(answer.parts, rng)
            distances = mutual_distances(points, sample_surface(true.mesh, SAMPLES, rng))
            whole = trimesh.Trimesh(
                *trimesh.util.append_faces(
                    [part.vertices for part in answer.parts], [part.faces for part in answer.parts]
                ),
                process=False,
            )
            agreed = [
                agreement_with_depth(
                    {label: whole},
                    frame.labels,
                    frame.depth,
                    frame.camera,
                    invert_rigid(frame.camera.T_world_camera),
                )[label]
                for frame in scene.frames[: len(frames)]
                if frame.labels is not None
            ]
            row |= {
                "chamfer_mm": 1e3 * chamfer_of_distances(distances),
                "fscore_5mm": fscore_of_distances(distances, 0.005),
                "iou_2_5mm": iou_of_union(answer.parts, true),
                "agreement": together(agreed).agreement,
                "uncertainty": answer.uncertainty,
            }
        rows.append(row)
    return rows


def of_contramap(scene: ManyViews, frames: Sequence[Frame]) -> tuple[dict[int, Answer], float]:
    """The project's map of all views, and how well p(uncertain) tells occluded from seen space."""
    from perception.space import Region
    from reconstruction import reconstruct
    from tools.evaluation.statistics import auroc

    result = reconstruct(frames)
    centres = np.array([solid.mesh.bounds.mean(0) for solid in scene.solids.values()])
    low, high = centres.min(0) - CARD_RADIUS, centres.max(0) + CARD_RADIUS
    axes = [np.arange(a, b, CARD_SPACING) for a, b in zip(low, high)]
    world = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    near = (np.linalg.norm(world[:, None] - centres, axis=2) < CARD_RADIUS).any(1)
    T = invert_rigid(result.T_world_table)
    local = (world[near] @ T[:3, :3].T + T[:3, 3]).astype(np.float32)
    region = result.space.classify(local)
    occluded = region == Region.OCCLUDED
    asked = occluded | (region == Region.FREE) | (region == Region.SURFACE)
    uncertain = result.map.predict_proba(local[asked])[:, -1]
    answers = {item.label: Answer((item.mesh,), item.mean_uncertainty) for item in result}
    return answers, auroc(uncertain, occluded[asked])


def of_tsdf(scene: ManyViews, frames: Sequence[Frame]) -> tuple[dict[int, Answer], float]:
    """Open3D's TSDF fusion of each object's masked depth in all views."""
    from perception.views.joint_space import space_of
    from perception.views.observing_together import observe_together
    from tools.evaluation.fitted_map import View
    from tools.evaluation.tsdf import FittedTsdf

    joint = observe_together(frames)
    view = View(joint.views[0].frame, joint, space_of(joint))
    T_world_table = view.frame.camera.T_world_camera @ invert_rigid(joint.T_table_camera)
    answers = {}
    for item, surface in zip(joint.objects, FittedTsdf(view).meshes(view)):
        if surface is not None:
            mesh = surface.mesh.copy().apply_transform(T_world_table)
            answers[item.label] = Answer((mesh,), float(surface.uncertainty.mean()))
    return answers, float("nan")


def of_union(scene: ManyViews, frames: Sequence[Frame]) -> tuple[dict[int, Answer], float]:
    """The null: every view mapped by itself, meshes of one object taken together."""
    parts: dict[int, list[trimesh.Trimesh]] = {}
    for frame in frames:
        for item in scene.alone(frame):
            parts.setdefault(item.label, []).append(item.mesh)
    return {label: Answer(tuple(of_one)) for label, of_one in parts.items()}, float("nan")


METHODS = {"contramap": of_contramap, "tsdf": of_tsdf, "union": of_union}


def wrong_pose(scene: ManyViews, shift: float) -> list[dict[str, Any]]:
    """Rows for all views with the second one's pose wrong by `shift` [m], and for all but that one."""
    rng = np.random.default_rng(len(scene.name))
    direction = rng.standard_normal(3)
    frame = scene.frames[1]
    T = frame.camera.T_world_camera.copy()
    T[:3, 3] += shift * direction / np.linalg.norm(direction)
    moved = frame.renamed({})
    object.__setattr__(moved, "camera", Camera(frame.camera.K, frame.camera.width, frame.camera.height, T))
    others = [scene.frames[0], *scene.frames[2:]]
    count = len(scene.frames)
    kept = ManyViews(scene.name, others, scene.solids)
    return [
        {"method": "contramap", "views": name, **row}
        for name, frames in (
            (f"{count - 1} (without view 2)", others),
            (f"{count}, view 2 wrong", [*others, moved]),
        )
        for row in judge(kept, "contramap", frames)
    ]


HEAD = """# Several views

`python -m tools.views SCENES --out docs/results/views.md`: means over the objects that show at least 200
pixels in the first view. Chamfer and F-score on 10,000 samples, IoU on a 2.5 mm grid, agreement within 3 mm
over the views used, uncertainty: mean p(uncertain) at vertices, occlusion_auroc: how well p(uncertain) tells
space that no view has seen from the rest, seconds a scene. "wrong": the pose of view 2 is off by
{wrong:.0f} mm.

"""


def table(rows: Sequence[dict[str, Any]], scenes: int) -> str:
    """Markdown: a line for each method and number of views."""
    lines = [
        "| method | views | objects | missing | " + " | ".join(METRICS) + " |",
        "|---|---|---|---|" + "---|" * len(METRICS),
    ]
    for method, views in dict.fromkeys((row["method"], row["views"]) for row in rows):
        own = [row for row in rows if (row["method"], row["views"]) == (method, views)]
        figures = []
        for metric in METRICS:
            values = np.array([row.get(metric, np.nan) for row in own], float)
            mean = values[np.isfinite(values)].mean() if np.isfinite(values).any() else np.nan
            figures.append("-" if np.isnan(mean) else f"{mean:.3f}" if mean < 2 else f"{mean:.2f}")
        missing = sum("chamfer_mm" not in row for row in own)
        lines.append(f"| {method} | {views} | {len(own)} | {missing} | " + " | ".join(figures) + " |")
    return "\n".join(lines) + f"\n\n{scenes} scenes.\n"


if __name__ == "__main__":
    sys.exit(exit_code("views", lambda: tyro.cli(main)))
