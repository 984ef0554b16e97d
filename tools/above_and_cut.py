"""How much worse a map gets where the camera hangs straight above, or the image's border cuts an object.

`python -m tools.above_and_cut SCENES --table above_and_cut.md` maps each scene as it was made (tilted), from
straight above, and turned aside until an object is cut; every object is compared with its own tilted view.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import tyro

from mapping.errors import ConfigError, ContraMapError
from perception.camera import invert_rigid, transform
from perception.frame import Frame
from tools.exit_code import exit_code
from tools.markdown import markdown_table
from tools.pieces import earlier, named_pieces
from tools.provenance import provenance, with_provenance

if TYPE_CHECKING:
    from reconstruction.result import Reconstruction
    from reconstruction.solid import Solid
    from sim_scenes.other_views import OtherViews

LEAST_PIXELS = 500
"""Objects that show fewer pixels in one of two compared views are not judged."""
LEAST_SHOWN = 0.5
"""Neither are cut ones of which less than this share shows ..."""
UNCUT = 0.98
"""... and those of which more does are not cut."""
CUT = (0.15, 0.5)
"""Least and largest share of an object's pixels beyond the border that is aimed at."""
SPACING = 0.004
"""Insides are compared on a grid of this spacing [m]."""
CLOSE = 0.1
"""A difference of IoU that is no loss."""
HOVERS = 0.01
"""A mesh whose lowest point lies this far over the true one hovers [m]."""
SURE = 0.3
"""What is called empty with less p(uncertain) than this is surely free."""


@dataclass(frozen=True)
class Scene:
    """One scene: its frame, the map of it, and its true insides by label [m, world frame]."""

    name: str
    views: OtherViews
    frame: Frame
    solids: dict[int, Solid]
    tilted: Reconstruction


def main(
    scenes: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")] = None,
    cuts: int = 2,
    ycb: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    first: int = 0,
    limit: int = 1000,
    seed: int = 0,
    add: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="FILE")] = (),
    json: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    table: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
) -> None:
    """Compare views from above, and cut ones, with tilted ones.

    Args:
        scenes: Scenes with truth, as `contramap scenes` makes them.
        cuts: Cut views of each scene, one object aimed at in each.
        ycb: Folder of YCB scans, for scenes made of them.
        first: Scenes passed over before the first that is looked at.
        limit: Scenes looked at, at most.
        seed: Which objects are cut, how far and at which side.
        add: Files written by --json before, whose rows are added to the table.
        json: Also write the figures to this file.
        table: Also write them as markdown tables to this file.
    """
    from tqdm import tqdm

    from mapping.files import write_atomically
    from sim_scenes.truth import TRUTH_FILE
    from tools.options import write_json

    if scenes is None and not add:
        raise ConfigError("give a folder of scenes, or --add FILE")
    if limit < 1 or min(first, cuts) < 0:
        raise ConfigError(f"--limit is 1 or more, --first and --cuts 0 or more; got {limit}, {first}, {cuts}")
    folders = sorted(path.parent for path in scenes.glob(f"*/{TRUTH_FILE}")) if scenes else []
    if scenes is not None and not folders[first:]:
        raise ConfigError(f"{scenes}: no scenes here; `contramap scenes {scenes}` makes some")
    rows, written_by = earlier(add)
    written_by += [provenance()] if scenes else []
    for folder in tqdm(folders[first : first + limit], desc="scenes", disable=not folders):
        rows += judge(load_scene(folder, ycb), cuts, np.random.default_rng([seed, *folder.name.encode()]))
        write_json({"written_by": written_by, "rows": rows}, json)  # what is finished is kept
    text = markdown(rows, written_by)
    print(text)
    write_json({"written_by": written_by, "rows": rows}, json)
    if table is not None:
        write_atomically(table, with_provenance("Seen from straight above, and cut by the border", text))


def load_scene(folder: Path, ycb: Path | None = None) -> Scene:
    """A scene folder, with its map."""
    from perception import load_frame
    from reconstruction import reconstruct
    from reconstruction.solid import Solid
    from sim_scenes.other_views import OtherViews
    from sim_scenes.truth import load_truth

    truth = load_truth(folder, ycb)
    frame = load_frame(truth.views[0])
    solids = {label: Solid(mesh) for label, mesh in truth.meshes.items()}
    return Scene(f"{folder.parent.name}/{folder.name}", OtherViews(truth), frame, solids, reconstruct(frame))


def judge(scene: Scene, cuts: int, rng: np.random.Generator) -> list[dict[str, Any]]:
    """A row for each object that a view from above, or a cut view, shows well enough."""
    from sim_scenes.other_views import SIDES, shown, whole

    labels = [label for label in scene.solids if _pixels(scene.frame, label) >= LEAST_PIXELS]
    labels = whole(scene.frame, labels)
    above = scene.views.from_above(scene.frame.camera)
    rows = _rows(scene, "above", above, dict.fromkeys(whole(above, labels), 1.0))
    for label in rng.permutation(labels)[:cuts]:
        share, side = float(rng.uniform(*CUT)), SIDES[int(rng.integers(len(SIDES)))]
        frame = scene.views.cut(scene.frame, int(label), share, side)
        shares = {other: shown(scene.frame, other, frame.camera) for other in labels}
        judged = {other: share for other, share in shares.items() if LEAST_SHOWN <= share <= UNCUT}
        rows += _rows(scene, "cut", frame, judged)
    return rows


def _rows(scene: Scene, view: str, frame: Frame, judged: dict[int, float]) -> list[dict[str, Any]]:
    """A row for each label of a view; judged: label -> share of its pixels that shows."""
    from reconstruction import reconstruct

    judged = {label: share for label, share in judged.items() if _pixels(frame, label) >= LEAST_PIXELS}
    if not judged:
        return []
    result, refused = None, ""
    try:
        result = reconstruct(frame)
    except ContraMapError as error:
        refused = str(error)
    return [
        {
            "scene": scene.name,
            "view": view,
            "label": label,
            "name": frame.names.get(label, ""),
            "shown": share,
            "refused": refused,
            "tilted": scores(scene.tilted, label, scene.solids[label]),
            "seen": scores(result, label, scene.solids[label]),
        }
        for label, share in judged.items()
    ]


def scores(result: Reconstruction | None, label: int, true: Solid) -> dict[str, float]:
    """IoU with the truth; hover: how far the mesh's lowest point lies over the true one [m]; and, of what
    lies beyond the image, the share that is surely free. No mesh: IoU 0."""
    from reconstruction.metrics import mesh_iou
    from sim_scenes.other_views import inside_image

    item = next((item for item in result.objects if item.label == label), None) if result else None
    if result is None or item is None:
        return {"iou": 0.0, "hover": float("nan"), "beyond_free": float("nan")}
    low, high = true.mesh.bounds
    points = np.random.default_rng(label).uniform(low, high, (4000, 3))
    points = points[true.inside(points)]
    camera = result.frame.camera
    beyond = points[~inside_image(camera, transform(invert_rigid(camera.T_world_camera), points))]
    free = float("nan")
    if len(beyond):
        answer = result.query(beyond)
        free = float((answer.free & (answer.uncertainty < SURE)).mean())
    return {
        "iou": mesh_iou(item.mesh, true, SPACING),
        "hover": float(item.mesh.bounds[0][2] - true.mesh.bounds[0][2]),
        "beyond_free": free,
    }


def markdown(rows: list[dict[str, Any]], written_by: list[str]) -> str:
    """Tables: both kinds of views, scene by scene, and the objects that lose most or hover."""
    lines = [
        *named_pieces(written_by),
        f"Tilted: the scene's own view. Above: the camera straight above, all objects in its image. Cut: the "
        f"camera turned in place until {CUT[0]:.0%} to {CUT[1]:.0%} of an object's pixels lie beyond the "
        f"border; all objects of which {LEAST_SHOWN:.0%} to {UNCUT:.0%} still show are judged. Loss: IoU of "
        f"the tilted view less that of this one (grid of {1e3 * SPACING:g} mm, at least {LEAST_PIXELS} "
        "pixels in both). Hover: lowest point of the mesh over that of the true object.",
        "",
        markdown_table([["scenes of", *SUMMARY], *_by_set(rows)]),
        "## Scene by scene\n",
        markdown_table([SUMMARY_OF_SCENE, *_by_scene(rows)]),
        f"## Objects that lose more than {CLOSE:g} or hover more than {1e3 * HOVERS:g} mm\n",
        markdown_table(
            [OBJECT, *(_object(row) for row in sorted(rows, key=_loss, reverse=True) if _odd(row))]
        ),
    ]
    return "\n".join(lines)


SUMMARY = [
    "view",
    "scenes",
    "objects",
    "IoU tilted",
    "IoU",
    "mean loss",
    f"objects within {CLOSE:g}",
    "hover, median [mm]",
    "largest [mm]",
    f"hover > {1e3 * HOVERS:g} mm",
    "surely free beyond the border",
]
SUMMARY_OF_SCENE = ["scene", *SUMMARY[:1], *SUMMARY[2:-1]]
OBJECT = ["scene", "view", "object", "shown", "IoU tilted", "IoU", "loss", "hover tilted [mm]", "hover [mm]"]


def _summary(view: str, rows: list[dict[str, Any]]) -> list[str]:
    if not rows:
        return [view, "0", "0", *(len(SUMMARY) - 3) * ["-"]]
    hover = 1e3 * np.array([row["seen"]["hover"] for row in rows])
    free = np.array([row["seen"]["beyond_free"] for row in rows])
    return [
        view,
        str(len({row["scene"] for row in rows})),
        str(len(rows)),
        f"{np.mean([row['tilted']['iou'] for row in rows]):.3f}",
        f"{np.mean([row['seen']['iou'] for row in rows]):.3f}",
        f"{np.mean([_loss(row) for row in rows]):.3f}",
        f"{np.mean([_loss(row) <= CLOSE for row in rows]):.0%}",
        f"{np.nanmedian(hover):.0f}" if np.isfinite(hover).any() else "-",
        f"{np.nanmax(hover):.0f}" if np.isfinite(hover).any() else "-",
        str(int((hover > 1e3 * HOVERS).sum())),
        f"{np.nanmean(free):.2%}" if np.isfinite(free).any() else "-",
    ]


def _by_set(rows: list[dict[str, Any]]) -> list[list[str]]:
    found = []
    for name in dict.fromkeys(row["scene"].split("/")[0] for row in rows):
        mine = [row for row in rows if row["scene"].split("/")[0] == name]
        found += [[name, *_summary(view, _of(mine, view))] for view in ("above", "cut")]
    return found


def _by_scene(rows: list[dict[str, Any]]) -> list[list[str]]:
    found = []
    for scene in sorted({row["scene"] for row in rows}):
        for view in ("above", "cut"):
            mine = [row for row in _of(rows, view) if row["scene"] == scene]
            if mine:
                view_name, _, *figures = _summary(view, mine)
                found.append([scene, view_name, *figures[:-1]])
    return found


def _object(row: dict[str, Any]) -> list[str]:
    return [
        row["scene"],
        row["view"],
        f"{row['label']} {row['name']}" + (f" ({row['refused']})" if row["refused"] else ""),
        f"{row['shown']:.0%}",
        f"{row['tilted']['iou']:.2f}",
        f"{row['seen']['iou']:.2f}",
        f"{_loss(row):.2f}",
        f"{1e3 * row['tilted']['hover']:.0f}",
        f"{1e3 * row['seen']['hover']:.0f}",
    ]


def _of(rows: list[dict[str, Any]], view: str) -> list[dict[str, Any]]:
    return [row for row in rows if row["view"] == view]


def _loss(row: dict[str, Any]) -> float:
    return float(row["tilted"]["iou"] - row["seen"]["iou"])


def _odd(row: dict[str, Any]) -> bool:
    return _loss(row) > CLOSE or not row["seen"]["hover"] < HOVERS


def _pixels(frame: Frame, label: int) -> int:
    assert frame.labels is not None
    return int((frame.labels == label).sum())


if __name__ == "__main__":
    sys.exit(exit_code("above_and_cut", lambda: tyro.cli(main)))
