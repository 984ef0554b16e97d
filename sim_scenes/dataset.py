"""Makes folders of simulated scenes: frames, labels and truth, reproducible from a seed."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mapping.errors import ConfigError, DataError
from mapping.files import write_atomically
from mapping.folders import staged_folder
from perception.camera import Camera
from perception.frame import Frame
from perception.frame_io import save_frame
from sim_scenes.convex_parts import build_all
from sim_scenes.object_source import ObjectSource, object_source
from sim_scenes.objects import ycb
from sim_scenes.objects.mesh_folder import FolderConfig, MeshFolder
from sim_scenes.objects.split import HELD_OUT_SHARE
from sim_scenes.pose_noise import check_pose_noise, noisy_pose
from sim_scenes.render import Renderer, random_cameras
from sim_scenes.sensor_noise import noisy_depth, noisy_labels
from sim_scenes.surroundings import Surroundings
from sim_scenes.tabletop import PlacedObject, Tabletop, TabletopConfig
from sim_scenes.truth import TRUTH_FILE, load_truth

DEPTH_SCALE = 1e-4
"""Metres per unit of depth.png: fine enough that the file adds no error that matters."""
MIN_VISIBLE_PIXELS = 200
"""Objects that show less in the first view are taken off the table before the scene is kept."""
LOOK_AT_HEIGHT = 0.04
"""Height [m] of the point the cameras look at."""
OBJECTS_FILE = "objects.json"
"""Beside scenes of a folder of meshes: which objects could be drawn, and which are in the scenes."""
ATTEMPTS = 20
"""Tries to compose a scene with enough objects before giving up."""


def generate(
    out: str | Path,
    count: int,
    seed: int = 0,
    objects: str = "auto",
    ycb_dir: str | Path | None = None,
    views: int = 3,
    sensor_noise: bool = False,
    label_noise: bool = False,
    progress: bool = True,
    folder: FolderConfig | None = None,
    pose_noise: tuple[float, float] | None = None,
) -> list[Path]:
    """Make `count` scenes below `out`, named scene_0000 and on; finished ones of the same settings are kept.

    pose_noise: the stated poses of all views but the first are wrong by up to so many metres and degrees;
    truth.json has the true ones.
    folder: which objects, where `objects` is a folder of meshes; OUT/objects.json then records the choice.
    Scene i depends on (seed, i) and the settings alone. Returns the scene folders.
    Raises ConfigError for senseless arguments or a folder whose scenes were made with other settings.
    """
    from tqdm import tqdm

    if count < 1 or views < 1:
        raise ConfigError(f"count and views must be at least 1, got count={count}, views={views}")
    source = object_source(objects, ycb_dir, folder)
    settings: dict[str, Any] = {
        "seed": seed,
        "objects": source.kind,
        "views": views,
        "sensor_noise": sensor_noise,
        "label_noise": label_noise,
    }
    check_pose_noise(pose_noise)
    if pose_noise is not None:
        settings["pose_noise"] = list(pose_noise)
    if source.folder is not None:
        settings["objects_of"] = source.folder.record()
    folders = [Path(out) / f"scene_{index:04d}" for index in range(count)]
    todo = [index for index, folder in enumerate(folders) if not _finished(folder, settings)]
    for index in tqdm(todo, desc="scenes", disable=not progress):
        rng = np.random.default_rng([seed, index])
        make_scene(folders[index], source, rng, settings, progress)
    # Also when all scenes are there: a run may have been killed after the last of them.
    if source.folder is not None and (todo or not (Path(out) / OBJECTS_FILE).is_file()):
        _write_choice(Path(out) / OBJECTS_FILE, source.folder, folders)
    return folders


def make_scene(
    folder: Path,
    source: ObjectSource,
    rng: np.random.Generator,
    settings: dict[str, Any],
    progress: bool = False,
) -> None:
    """Compose, settle, render and write one scene; the folder appears only when it is complete."""
    config = TabletopConfig()
    placed, cameras = compose(source, settings["views"], rng, config, progress)
    write_scene(folder, placed, cameras, source, settings, rng, config)


def write_scene(
    folder: Path,
    placed: Sequence[PlacedObject],
    cameras: Sequence[Camera],
    source: ObjectSource,
    settings: dict[str, Any],
    rng: np.random.Generator,
    config: TabletopConfig,
) -> None:
    """Render objects at rest from each camera and write the scene; the folder appears only when complete."""
    surroundings = Surroundings.random(config.table_size_m, rng)
    renderer = Renderer(placed, surroundings)
    views = [".", *(f"views/{view}" for view in range(1, len(cameras)))]
    with staged_folder(folder, last=TRUTH_FILE) as partial:
        for camera, view in zip(cameras, views):
            frame = _frame(renderer, camera, placed, rng, settings)
            save_frame(frame, partial / view, DEPTH_SCALE)
        if "pose_noise" in settings:
            _misstate_poses(partial, views[1:], settings, rng)
        poses = [camera.T_world_camera for camera in cameras]
        _write_truth(partial, placed, source, settings, views, poses)


def _misstate_poses(
    folder: Path, views: Sequence[str], settings: dict[str, Any], rng: np.random.Generator
) -> None:
    """Put a wrong pose into the camera files of views."""
    for view in views:
        path = folder / view / "camera.json"
        content = json.loads(path.read_text())
        shift, turn = settings["pose_noise"]
        wrong = noisy_pose(np.array(content["T_world_camera"]), shift, turn, rng)
        path.write_text(json.dumps({**content, "T_world_camera": wrong.tolist()}, indent=1) + "\n")


def _frame(
    renderer: Renderer,
    camera: Camera,
    placed: Sequence[PlacedObject],
    rng: np.random.Generator,
    settings: dict[str, Any],
) -> Frame:
    depth, labels = renderer.depth_and_labels(camera)
    rgb = renderer.rgb(camera, rng)
    if settings["label_noise"]:
        labels = noisy_labels(labels, rng)
    if settings["sensor_noise"]:
        depth = noisy_depth(depth, camera, rng)
    names = {label: item.model.name for label, item in enumerate(placed, start=1)}
    return Frame(depth, camera, rgb, labels, names, "simulated")


def compose(
    source: ObjectSource,
    views: int,
    rng: np.random.Generator,
    config: TabletopConfig,
    progress: bool = False,
) -> tuple[list[PlacedObject], list[Camera]]:
    """Objects at rest on a table that all show in the first camera, and the cameras around them."""
    fewest, most = config.objects
    for _ in range(ATTEMPTS):
        models = source.draw(int(rng.integers(fewest, most + 1)), rng)
        build_all(models, progress=progress)
        with Tabletop(config) as table:
            table.drop(models, rng)
            if not table.placed():
                continue
            cameras = random_cameras(views, _middle(table.placed()), rng)
            while placed := table.placed():
                hidden = _hidden(placed, cameras[0])
                if not hidden:
                    break
                table.remove(hidden)  # others may move then, so look again
        if len(placed) >= fewest:
            return placed, cameras
    raise DataError(
        f"no scene with {fewest} visible objects in {ATTEMPTS} tries; the objects may be too small, "
        "or roll off the table"
    )


def _middle(placed: Sequence[PlacedObject]) -> np.ndarray:
    """(3,) point [m] in the middle of the objects, a little above the table: what the cameras look at."""
    centers = np.array([item.T_world_object[:3] @ [*item.model.center_of_mass, 1.0] for item in placed])
    middle = (centers.min(axis=0) + centers.max(axis=0)) / 2
    return np.array([middle[0], middle[1], LOOK_AT_HEIGHT])


def _hidden(placed: Sequence[PlacedObject], camera: Camera) -> list[int]:
    plain = Surroundings.plain(TabletopConfig().table_size_m)
    _, labels = Renderer(placed, plain).depth_and_labels(camera)
    visible = np.bincount(labels.ravel(), minlength=len(placed) + 1)[1:]
    return [index for index, pixels in enumerate(visible) if pixels < MIN_VISIBLE_PIXELS]


def _write_truth(
    folder: Path,
    placed: Sequence[PlacedObject],
    source: ObjectSource,
    settings: dict[str, Any],
    views: Sequence[str],
    poses: Sequence[np.ndarray],
) -> None:
    objects = []
    for label, item in enumerate(placed, start=1):
        model = item.model
        if source.ycb_dir is not None:
            mesh = (Path(model.name) / ycb.MESH_FILE).as_posix()
        else:
            mesh = f"meshes/{label}_{model.name}.ply"
            (folder / "meshes").mkdir(exist_ok=True)
            model.save(folder / mesh)
        objects.append(
            {
                "label": label,
                "name": model.name,
                "source": model.source,
                "mesh": mesh,
                "scale": 1.0,
                "T_world_object": item.T_world_object.tolist(),
                "watertight": model.watertight,
            }
        )
    truth = {
        **settings,
        "support_plane": [0.0, 0.0, 1.0, 0.0],
        "views": list(views),
        "T_world_camera": [pose.tolist() for pose in poses],
        "ycb_dir": None if source.ycb_dir is None else str(source.ycb_dir),
        "settings": settings,
        "objects": objects,
    }
    (folder / TRUTH_FILE).write_text(json.dumps(truth, indent=1) + "\n")


def _write_choice(path: Path, folder: MeshFolder, scenes: Sequence[Path]) -> None:
    """Record the objects that could be drawn, those in the scenes, and those passed over with the reason."""
    truths = [json.loads((scene / TRUTH_FILE).read_text()) for scene in scenes]
    choice = {
        **folder.record(),
        "held_out_share": HELD_OUT_SHARE,
        "candidates": sorted(folder.files),
        "in_scenes": sorted({item["name"] for truth in truths for item in truth["objects"]}),
        "passed_over": dict(sorted(folder.refused.items())),
    }
    write_atomically(path, (json.dumps(choice, indent=1) + "\n").encode())


def _finished(folder: Path, settings: dict[str, Any]) -> bool:
    """Whether a scene is there already; ConfigError when it was made with other settings."""
    if not (folder / TRUTH_FILE).is_file():
        if folder.exists():
            raise ConfigError(f"{folder} is there but is no scene; choose another output folder")
        return False
    load_truth(folder)
    made_with = json.loads((folder / TRUTH_FILE).read_text()).get("settings")
    if made_with != settings:
        raise ConfigError(
            f"{folder} was made with other settings ({made_with}); choose another output folder or delete it"
        )
    return True
