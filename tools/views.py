"""How much further views are worth: the map of 1, 2, 3 and more views beside TSDF fusion of the same views
and the union of single-view meshes.

`python -m tools.views SCENES --views 1 2 3 5 --out docs/results/views.md` writes the table; scenes come from
`contramap scenes SCENES --views 5`. Objects that show at least 200 pixels in the first view are judged, so
that every row judges the same ones.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import trimesh
import tyro

from mapping.errors import ConfigError
from perception.camera import Camera, invert_rigid
from perception.frame import Frame
from sim_scenes.pose_noise import DEGREES_A_METRE, noisy_pose
from tools.evaluation.several_views import METHODS, ManyViews
from tools.evaluation.unions import SAMPLES, iou_of_union, surface_of_union
from tools.exit_code import exit_code

if TYPE_CHECKING:
    from reconstruction.surface.agreement import Agreement

LEAST_PIXELS = 200
"""Objects that show fewer pixels in the first view are not judged."""
METRICS = (
    "chamfer_mm",
    "fscore_5mm",
    "iou_2_5mm",
    "agreement",
    "agreement_all",
    "uncertainty",
    "occlusion_auroc",
    "seconds",
)


def main(
    scenes: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="DIR")],
    views: tuple[int, ...] = (1, 2, 3, 5),
    methods: tuple[str, ...] = ("contramap", "tsdf", "union"),
    wrong: Annotated[float, tyro.conf.arg(metavar="M")] = 0.02,
    pose_noise: Annotated[tuple[float, ...], tyro.conf.arg(metavar="M")] = (),
    limit: int = 100,
    ycb: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    json: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
) -> None:
    """Judge maps of several views.

    Args:
        scenes: Folders of scenes with truth and views, as `contramap scenes --views V` makes them; a table
            for each.
        views: Numbers of views.
        methods: contramap, tsdf (masked depth fused by Open3D), union (of single-view meshes).
        wrong: Also map the most views with one pose wrong by this much, and without that view; 0: do not [m].
        pose_noise: Also map the most views with all poses but the first wrong by up to this much each [m];
            200 degrees a metre go with it: 2 at 10 mm.
        limit: Scenes judged of each folder, at most.
        ycb: Folder of YCB scans, for scenes made of them.
        out: Also write the table to this Markdown file.
        json: Also write the figures to this file after each line; those that it has are not judged again.
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
    if not scenes:
        raise ConfigError("name a folder of scenes; `contramap scenes DIR --views 5` makes some")
    sets = {part: sorted(path.parent for path in part.glob(f"*/{TRUTH_FILE}"))[:limit] for part in scenes}
    for part, of_set in sets.items():
        if not of_set:
            raise ConfigError(
                f"{part}: no scenes here; `contramap scenes {part} --views {max(views)}` makes some"
            )
    folders = [folder for of_set in sets.values() for folder in of_set]
    rows = _judged_before(json)
    done = {(row["folder"], row["method"], row["views"]) for row in rows}
    progress = tqdm(folders, desc="scenes")
    asked = _asked(views, methods, wrong, pose_noise)
    for folder in progress:
        place = str(folder.resolve())
        todo = [key for key in asked if (place, *key) not in done]
        scene = load_scene(folder, max(views), ycb) if todo else None
        for key in todo:
            assert scene is not None
            progress.set_postfix_str(" ".join(key))
            frames = frames_of(scene, key[1])
            found = judge(replace(scene, frames=frames), key[0], scene.frames)
            rows += [{"folder": place, "method": key[0], "views": key[1], **row} for row in found]
            write_json({"rows": rows}, json)
    rows = [row for row in rows if (row["method"], row["views"]) in asked]
    rows.sort(key=lambda row: asked.index((row["method"], row["views"])))
    parts = []
    for part, of_set in sets.items():
        wanted = {str(folder.resolve()) for folder in of_set}
        own = [row for row in rows if row["folder"] in wanted]
        head = f"## {part.resolve().name}\n\n" if len(sets) > 1 else ""
        parts.append(head + table(own, len({row["folder"] for row in own})))
    text = "\n".join(parts)
    print(text)
    if out is not None:
        write_atomically(out, (HEAD + text).encode())


def _judged_before(path: Path | None) -> list[dict[str, Any]]:
    """Rows that an earlier run has written."""
    from mapping.guarded_files import read_json

    if path is None or not path.is_file():
        return []
    content = read_json(path)
    if not isinstance(content, dict) or not isinstance(content.get("rows"), list):
        raise ConfigError(f"{path}: holds no figures of this command; name another file")
    return list(content["rows"])


WITHOUT, OFF = "(without view 2)", "mm off"
"""How the names of lines end that do not simply take the first views."""


def _asked(
    views: Sequence[int], methods: Sequence[str], wrong: float, pose_noise: Sequence[float]
) -> list[tuple[str, str]]:
    """Method and name of the views of each line of the table."""
    most = max(views)
    asked = [(method, str(count)) for method in methods for count in sorted(views)]
    if wrong and most > 2:
        asked += [
            ("contramap", f"{most - 1} {WITHOUT}"),
            ("contramap", f"{most}, view 2 {1e3 * wrong:g} {OFF}"),
        ]
    return asked + [("contramap", f"{most}, all to {1e3 * size:g} {OFF}") for size in pose_noise]


def frames_of(scene: ManyViews, name: str) -> list[Frame]:
    """The views of a line, by its name."""
    first, *others = scene.frames
    if name.isdigit():
        return scene.frames[: int(name)]
    if name.endswith(WITHOUT):
        return [first, *others[1:]]
    size, rng = float(name.split()[-3]) / 1e3, np.random.default_rng(len(scene.name))
    if " all " in name:
        turn = DEGREES_A_METRE * size
        return [
            first,
            *(posed(one, noisy_pose(one.camera.T_world_camera, size, turn, rng)) for one in others),
        ]
    direction = rng.standard_normal(3)
    T = others[0].camera.T_world_camera.copy()
    T[:3, 3] += size * direction / np.linalg.norm(direction)
    return [first, *others[1:], posed(others[0], T)]


def load_scene(folder: Path, count: int, ycb: Path | None = None) -> ManyViews:
    """A scene folder's views and its truth, in the order in which they are added: each farthest from those
    before it. Raises ConfigError when it has fewer than `count`."""
    from perception.frame_io import load_frame
    from reconstruction.solid import Solid
    from sim_scenes.truth import load_truth

    truth = load_truth(folder, ycb)
    if len(truth.views) < count:
        raise ConfigError(f"{folder}: has {len(truth.views)} views; make scenes with --views {count}")
    frames = farthest_first([load_frame(view) for view in truth.views])[:count]
    labels = frames[0].labels
    assert labels is not None
    pixels = np.bincount(labels.ravel(), minlength=max(truth.meshes) + 1)
    judged = {label: Solid(mesh) for label, mesh in truth.meshes.items() if pixels[label] >= LEAST_PIXELS}
    return ManyViews(folder.name, frames, judged)


def farthest_first(frames: Sequence[Frame]) -> list[Frame]:
    """Frames in an order that starts with the first and goes on with the one taken farthest from those that
    went before: of a circle of eight, five leave no side out."""
    places = np.stack([frame.camera.T_world_camera[:3, 3] for frame in frames])
    apart = np.linalg.norm(places[:, None] - places, axis=2)
    order = [0]
    while len(order) < len(frames):
        nearest = apart[order].min(0)
        nearest[order] = -1
        order.append(int(nearest.argmax()))
    return [frames[index] for index in order]


def judge(scene: ManyViews, method: str, every: Sequence[Frame] = ()) -> list[dict[str, Any]]:
    """One row of figures for each judged object; one that got no mesh has IoU and F-score 0.

    every: all views that there are of the scene, used or not: `agreement_all` is over them.
    """
    from time import perf_counter

    from reconstruction.metrics import (
        chamfer_of_distances,
        fscore_of_distances,
        mutual_distances,
        sample_surface,
    )
    from reconstruction.surface.agreement import together

    start = perf_counter()
    answers, auroc = METHODS[method](scene, scene.frames)
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
            frames = {id(frame): frame for frame in [*scene.frames, *every]}
            agreed = {key: _agreement(label, whole, frame) for key, frame in frames.items()}
            row |= {
                "chamfer_mm": 1e3 * chamfer_of_distances(distances),
                "fscore_5mm": fscore_of_distances(distances, 0.005),
                "iou_2_5mm": iou_of_union(answer.parts, true),
                "agreement": together([agreed[id(frame)] for frame in scene.frames]).agreement,
                "agreement_all": together([agreed[id(frame)] for frame in every or scene.frames]).agreement,
                "uncertainty": answer.uncertainty,
            }
        rows.append(row)
    return rows


def _agreement(label: int, mesh: trimesh.Trimesh, frame: Frame) -> Agreement:
    """The agreement of one object's mesh [m, world frame] with the depth image of a frame."""
    from reconstruction.surface.agreement import agreement_with_depth

    assert frame.labels is not None
    T = invert_rigid(frame.camera.T_world_camera)
    return agreement_with_depth({label: mesh}, frame.labels, frame.depth, frame.camera, T)[label]


def posed(frame: Frame, T: np.ndarray) -> Frame:
    """The same images, said to be taken from elsewhere."""
    moved, camera = frame.renamed({}), frame.camera
    object.__setattr__(moved, "camera", Camera(camera.K, camera.width, camera.height, T))
    return moved


HEAD = """# Several views

`python -m tools.views SCENES --out docs/results/views.md`: means over the objects that show at least 200
pixels in the first view. Each view that is added is the one taken farthest from those before. Chamfer and
F-score on 10,000 samples, IoU on a 2.5 mm grid, agreement within 3 mm over the views used, agreement_all:
over all views there are of the scene, so that every line is judged on the same pixels; uncertainty: mean
p(uncertain) at vertices, occlusion_auroc: how well p(uncertain) tells space that no view has seen from the
rest, seconds a scene. "view 2 ... off": its pose is wrong by so much;
"all to ... off": every view but the first is said to be elsewhere, by up to so much each, and turned by up
to 0.2 degrees a millimetre.

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
