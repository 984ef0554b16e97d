"""What looking where the map is unsure is worth: next views by several rules, on simulated scenes with truth.

`python -m tools.looking_around SCENES --out docs/results/next_view.md`. Each rule starts from a scene's first
view, chooses among the same poses on a circle, and is judged by the p(uncertain) that is left around the true
objects after each view. Rules: look (`next_view`), rear side (unseen voxels right behind measured surfaces
that a pose is to see), circle (in fixed steps), random; and, to know what is left for any rule to win, best:
the pose that is found to leave least when all have been tried.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import tyro

from mapping.errors import ConfigError
from perception.camera import Camera, invert_rigid, transform
from perception.frame import Frame
from tools.exit_code import exit_code

if TYPE_CHECKING:
    from reconstruction.result import Reconstruction
    from sim_scenes.truth import Truth

SMALLER = 2
"""Images are this many times smaller than the scene's, a side."""
TABLE = 0.6
"""Half the side of the table [m]."""
VOXEL = 0.01
"""Voxels that uncertainty is summed over, and rear sides are counted in [m]."""
AROUND_ALL = 6
"""Views that take the circle once round, in steps of 60 degrees."""
AROUND = 0.03
"""They lie within this distance of the true objects' boxes [m]."""


@dataclass(frozen=True)
class World:
    """A scene that can be looked at from anywhere. truth: its shapes; camera: of its frames."""

    truth: Truth
    camera: Camera

    def frame(self, T_world_camera: np.ndarray) -> Frame:
        """What a camera without noise sees from a pose."""
        import trimesh

        from perception.ray_casting import ray_scene, tensor

        camera = Camera(self.camera.K, self.camera.width, self.camera.height, T_world_camera)
        labels = sorted(self.truth.meshes)
        table = trimesh.creation.box((2 * TABLE, 2 * TABLE, 0.02))
        low, high = self.bounds
        table.apply_translation([*((low + high) / 2)[:2], -0.01])
        meshes = [table, *(self.truth.meshes[label] for label in labels)]
        scene = ray_scene([(mesh.vertices, mesh.faces) for mesh in meshes])
        T = T_world_camera.astype(np.float32)
        directions = camera.rays @ T[:3, :3].T
        rays = np.concatenate([np.broadcast_to(T[:3, 3], directions.shape), directions], axis=-1)
        hits = scene.cast_rays(tensor(rays))
        depth, ids = hits["t_hit"].numpy(), hits["geometry_ids"].numpy().astype(np.int64)
        numbers = np.array([0, *labels, 0])[np.minimum(ids, len(labels) + 1)]
        names = {item.label: item.name for item in self.truth.objects}
        depth = np.where(np.isfinite(depth), depth, np.nan).astype(np.float32)
        return Frame(depth, camera, None, numbers.astype(np.uint16), names, "simulated")

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Corners (3,) [m] of the box around all objects."""
        bounds = np.array([mesh.bounds for mesh in self.truth.meshes.values()])
        return bounds[:, 0].min(0), bounds[:, 1].max(0)

    @property
    def voxels(self) -> np.ndarray:
        """(N, 3) float32 places [m, world frame] around the objects, above the table."""
        from perception.observation import near_boxes

        low, high = self.bounds
        axes = [np.arange(a, b, VOXEL) for a, b in zip(low - AROUND, high + AROUND)]
        nodes = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3).astype(np.float32)
        boxes = [tuple(mesh.bounds) for mesh in self.truth.meshes.values()]
        return nodes[near_boxes(nodes, boxes, AROUND) & (nodes[:, 2] > VOXEL / 2)]


def main(
    scenes: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="DIR")],
    views: int = 4,
    candidates: int = 12,
    limit: int = 100,
    first: int = 0,
    best: int = 0,
    ycb: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    json: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
) -> None:
    """Compare rules that choose the next view.

    Args:
        scenes: Folders of scenes with truth, as `contramap scenes` makes them.
        views: Views in all, the first one included; the circle goes on to six.
        candidates: Poses on the circle.
        limit: Scenes of each folder, at most.
        first: Scenes of each folder passed over before.
        best: Also try all poses for each view up to this one, and take the best; 0: do not. Slow.
        ycb: Folder of YCB scans, for scenes made of them.
        out: Also write the table to this Markdown file.
        json: Also write what was left after each view to this file, scene by scene and rule by rule; what it
            has is taken from it.
    """
    from tqdm import tqdm

    from mapping.files import write_atomically
    from mapping.guarded_files import read_json
    from sim_scenes.truth import TRUTH_FILE, load_truth
    from tools.options import write_json

    sets = [sorted(path.parent for path in part.glob(f"*/{TRUTH_FILE}")) for part in scenes]
    folders = [folder for of_set in sets for folder in of_set[first : first + limit]]
    if not folders or views < 2 or candidates < max(views, AROUND_ALL):
        places = " ".join(map(str, scenes))
        raise ConfigError(
            f"{places}: no scenes here, or --views {views} below 2, or --candidates below it or {AROUND_ALL}"
        )
    left: dict[str, dict[str, list[float]]] = {}
    if json is not None and json.is_file():
        left = dict(read_json(json)["left"])
    for folder in tqdm(folders, desc="scenes"):
        name = str(folder.resolve())
        todo = [rule for rule in (*RULES, *[BEST] * (best > 1)) if rule not in left.get(name, {})]
        if todo:
            found = of_scene(load_truth(folder, ycb), folder, todo, views, candidates, best)
            left[name] = {**left.get(name, {}), **found}
            write_json({"views": views, "candidates": candidates, "left": left}, json)
    text = table([left[str(folder.resolve())] for folder in folders], views)
    print(text)
    if out is not None:
        write_atomically(out, (HEAD.format(candidates=candidates) + text).encode())


def of_scene(
    truth: Truth, folder: Path, rules: Sequence[str], views: int, candidates: int, best: int
) -> dict[str, list[float]]:
    """Rule -> p(uncertain) left after 1, 2, ... views, as a share of what the first view leaves."""
    from perception.frame_io import load_frame
    from reconstruction import reconstruct
    from reconstruction.looking import poses_around

    own = load_frame(folder).camera
    K = own.K / SMALLER
    K[2, 2] = 1
    world = World(truth, Camera(K, own.width // SMALLER, own.height // SMALLER, own.T_world_camera))
    start = reconstruct(world.frame(own.T_world_camera))
    poses = poses_around(start, candidates)
    voxels = world.voxels
    whole = uncertainty(start, voxels)
    seen: dict[tuple[int, ...], Reconstruction] = {(): start}  # rules often agree
    left: dict[tuple[int, ...], float] = {(): 1.0}

    def look(taken: tuple[int, ...]) -> float:
        """What is left after the views of so many poses, one after the other."""
        if taken not in seen:
            seen[taken] = seen[taken[:-1]].update(world.frame(poses[taken[-1]]))
            left[taken] = uncertainty(seen[taken], voxels) / whole
        return left[taken]

    def others(taken: tuple[int, ...]) -> list[int]:
        return [index for index in range(1, candidates) if index not in taken]

    found = {}
    for rule in rules:
        rng = np.random.default_rng(len(truth.objects))
        taken: tuple[int, ...] = ()
        curve = [1.0]
        for step in range(1, {"circle": max(views, AROUND_ALL), BEST: best}.get(rule, views)):
            if rule == BEST:
                index = min(others(taken), key=lambda index: look((*taken, index)))
                for other in others((*taken, index)):
                    seen.pop((*taken, other), None)  # what is held of a dozen maps is a gigabyte
            else:
                index = RULES[rule](seen[taken], poses, others(taken), step, rng)
            taken = (*taken, index)
            curve.append(look(taken))
        found[rule] = curve
    return found


def uncertainty(result: Reconstruction, points: np.ndarray) -> float:
    """Sum of p(uncertain) at points (N, 3) [m, world frame]."""
    local = transform(invert_rigid(result.T_world_table), points)
    return float(result.map.predict_proba(local.astype(np.float32))[:, -1].sum())


Rule = Callable[["Reconstruction", np.ndarray, list[int], int, np.random.Generator], int]


def _look(result: Any, poses: np.ndarray, free: list[int], step: int, rng: np.random.Generator) -> int:
    from reconstruction.looking import next_view

    return free[next_view(result, poses[free]).best]


def _rear_side(result: Any, poses: np.ndarray, free: list[int], step: int, rng: np.random.Generator) -> int:
    """The pose that sees most unseen voxels right behind measured surfaces."""
    space = rear_sides(result)
    camera = result.frame.camera
    gains = [space.gain(camera, invert_rigid(poses[index]) @ result.T_world_table) for index in free]
    return free[int(np.argmax(gains))]


def rear_sides(result: Reconstruction) -> Any:
    """Unseen voxels with a measured one beside them, as rays meet them: what was measured is opaque."""
    from scipy import ndimage

    from perception.observation import near_boxes
    from perception.space import Region
    from reconstruction.looking import UncertainSpace

    boxes = [item.bounds for item in result.observation.objects]
    lows, highs = (np.array(ends) for ends in zip(*boxes))
    low, high = lows.min(0) - AROUND, highs.max(0) + AROUND
    low[2] = max(low[2], VOXEL / 2)
    axes = [np.arange(a, b + VOXEL, VOXEL) for a, b in zip(low, high)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), -1).astype(np.float32)
    flat = nodes.reshape(-1, 3)
    shape = nodes.shape[:3]
    unseen = np.isin(result.space.classify(flat), (Region.OCCLUDED, Region.OUT_OF_VIEW)).reshape(shape)
    cells = np.rint((np.concatenate([o.points for o in result.observation.objects]) - low) / VOXEL).astype(
        int
    )
    cells = cells[((cells >= 0) & (cells < shape)).all(1)]
    measured = np.zeros(shape, bool)
    measured[tuple(cells.T)] = True
    rear = unseen & ~measured & ndimage.binary_dilation(measured)
    counted = np.flatnonzero(rear.reshape(-1) & near_boxes(flat, boxes, AROUND))
    weights = np.ones(len(counted), np.float32)
    return UncertainSpace(low, VOXEL, measured.astype(np.float32), flat[counted], weights)


def _circle(result: Any, poses: np.ndarray, free: list[int], step: int, rng: np.random.Generator) -> int:
    """The next in steps of a sixth of the circle, or the first that is left."""
    wanted = step * max(1, len(poses) // 6)
    return wanted if wanted in free else free[0]


def _random(result: Any, poses: np.ndarray, free: list[int], step: int, rng: np.random.Generator) -> int:
    return int(rng.choice(free))


RULES: dict[str, Rule] = {"look": _look, "rear side": _rear_side, "circle": _circle, "random": _random}
BEST = "best"

HEAD = """# Where to look next

`python -m tools.looking_around SCENES`: p(uncertain) left around the true objects after each view, as a
share of what the first view leaves; means over scenes. The next view is chosen among {candidates} poses
on a circle: by `next_view` (look), by the number of unseen voxels right behind measured surfaces that it
is to see (rear side), in fixed steps of 60 degrees (circle), at random; best: whichever is found to leave
least when all have been tried. Paired tests: Wilcoxon's, two-sided.

"""


def table(curves: Sequence[dict[str, list[float]]], views: int) -> str:
    """Markdown: a line for each rule, and what the paired tests say."""
    from scipy.stats import wilcoxon

    rules = [rule for rule in (*RULES, BEST) if all(rule in curve for curve in curves)]
    rows = {rule: np.array([curve[rule] for curve in curves]) for rule in rules}
    most = max(values.shape[1] for values in rows.values())
    lines = ["| rule | " + " | ".join(f"{n} views" for n in range(2, most + 1)) + " |"]
    lines.append("|---|" + "---|" * (most - 1))
    for rule, values in rows.items():
        means = [f"{v:.3f}" for v in values.mean(0)[1:]] + ["-"] * (most - values.shape[1])
        lines.append(f"| {rule} | " + " | ".join(means) + " |")
    lines.append("")
    look, circle = rows["look"].mean(0), rows["circle"].mean(0)
    for n in range(2, most + 1):
        reached = np.flatnonzero(look <= circle[n - 1])
        after = f"after {reached[0] + 1} views" if len(reached) else f"not after {views} views"
        lines.append(f"- What the circle leaves after {n} views, look leaves {after}.")
    for rule in ("rear side", "circle", "random"):
        for n in range(1, views):
            apart = rows["look"][:, n] - rows[rule][:, n]
            p = wilcoxon(apart).pvalue if len(apart) > 5 and np.any(apart) else float("nan")
            better = int((apart < 0).sum())
            lines.append(
                f"- {n + 1} views: look leaves less than {rule} in {better} of {len(apart)} scenes, "
                f"{apart.mean():+.3f} on average (p = {p:.2g})"
            )
    return "\n".join(lines) + f"\n\n{len(curves)} scenes.\n"


if __name__ == "__main__":
    sys.exit(exit_code("looking_around", lambda: tyro.cli(main)))
