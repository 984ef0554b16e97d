"""What a frame folder, an .npz file or a cloud holds, as the parts of a frame. Knows names of files and
arrays."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mapping.errors import FrameError
from mapping.guarded_files import line, printable, read_json, read_npz
from perception.inputs.assemble import Parts
from perception.inputs.camera_file import (
    CAMERA_STEMS,
    HINT,
    POSE_STEMS,
    SUFFIXES,
    find_file,
    read_camera,
    read_pose_file,
)
from perception.inputs.camera_keys import CameraFile, camera_from_keys
from perception.inputs.depth_files import SUFFIXES as DEPTH_SUFFIXES
from perception.inputs.depth_files import StoredDepth, read_depth, single_channel
from perception.inputs.label_files import find_labels, mended
from perception.inputs.label_forms import Labels, as_labels

NPZ_LABELS = ("segmap", "seg", "labels", "masks", "instances", "instance_mask")
"""Names under which an .npz may hold its instance labels."""
NPZ_RGB = ("rgb", "color", "image")
NPZ_DEPTH = ("depth", "depth_m", "depths")
COLOR_STEMS = ("rgb", "color", "colour", "image")
COLOR_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")


def folder_parts(folder: Path) -> Parts:
    camera_path = find_file(folder, CAMERA_STEMS, SUFFIXES) or folder / "camera.json"
    camera = read_camera(camera_path)
    if camera_path.name == "camera.json":
        _check_size_given(camera_path)
    pose_path = find_file(folder, POSE_STEMS, SUFFIXES)
    if pose_path is not None and camera.T_world_camera is None:
        camera = replace(camera, T_world_camera=read_pose_file(pose_path))
    depth_path = find_file(folder, ("depth",), DEPTH_SUFFIXES)
    if depth_path is None:
        raise FrameError(
            f"{folder}: holds neither depth.png (16-bit) nor depth.npy (float metres); add one of them (or "
            f"depth.tiff, "
            "depth.exr)"
        )
    names_path = folder / "names.json"
    labels_path, others = find_labels(folder)
    notes: tuple[str, ...] = ()
    if labels_path is not None and others:
        notes = (f"{folder.name}: labels are read from {labels_path.name}; not used: {', '.join(others)}",)
    return Parts(
        depth=read_depth(depth_path),
        camera=camera,
        camera_name=str(camera_path),
        source=str(folder),
        rgb=find_file(folder, COLOR_STEMS, COLOR_SUFFIXES),
        labels=labels_path,
        names=_read_names(names_path) if names_path.exists() else {},
        scale_name=str(camera_path),
        notes=notes,
    )


def _check_size_given(path: Path) -> None:
    """camera.json with K must state the size that K is for: it is what tells a K of another stream."""
    content = _read_json(path, HINT)
    missing = [key for key in ("width", "height") if "K" in content and key not in content]
    if missing:
        raise FrameError(
            f"{path}: lacks {', '.join(missing)}; it must hold K (3x3), width, height and depth_scale"
        )


def npz_parts(path: Path) -> Parts:
    arrays = read_npz(path, None, FrameError)
    depth_key = next((key for key in NPZ_DEPTH if key in arrays), None)
    if depth_key is None:
        raise FrameError(
            f"{path}: lacks the array 'depth' (it holds {', '.join(sorted(arrays)) or 'nothing'}); "
            "save depth in metres and K (3x3)"
        )
    labels_key = next((key for key in NPZ_LABELS if key in arrays), None)
    rgb_key = next((key for key in NPZ_RGB if key in arrays and arrays[key].ndim >= 2), None)
    images = {depth_key, labels_key, rgb_key}
    values = {key: _plain(value) for key, value in arrays.items() if key not in images}
    try:
        camera = camera_from_keys(values, str(path))
    except FrameError as error:
        if "lacks K" in str(error):
            raise FrameError(
                f"{path}: lacks the array 'K' (it holds {', '.join(sorted(arrays))}); save depth in metres "
                f"and K (3x3)"
            ) from error
        raise
    rgb = None if rgb_key is None else arrays[rgb_key]
    labels = (
        None
        if labels_key is None
        else mended(as_labels(arrays[labels_key], f"{path}: {labels_key}"), path.name)
    )
    return Parts(
        depth=StoredDepth(single_channel(arrays[depth_key], path), path),
        camera=camera,
        camera_name=str(path),
        source=str(path),
        rgb=rgb,
        labels=labels,
        scale_name=str(path),
    )


def _plain(value: np.ndarray) -> Any:
    """A numpy scalar as Python has it."""
    return value.item() if value.ndim == 0 else value


def cloud_parts(path: Path) -> Parts:
    from perception.inputs.clouds import read_cloud

    camera_path = find_file(path.parent, CAMERA_STEMS, SUFFIXES)
    size = None
    if camera_path is not None:
        beside = read_camera(camera_path)
        size = None if beside.width is None or beside.height is None else (beside.width, beside.height)
    cloud = read_cloud(path, size)
    labels_path, _ = find_labels(path.parent)
    labels: Labels | Path | None = labels_path
    if cloud.labels is not None:
        labels = mended(as_labels(cloud.labels, f"{path}: label"), path.name)
    return Parts(
        depth=StoredDepth(cloud.depth, path),
        camera=CameraFile(cloud.K, T_world_camera=cloud.T_world_camera),
        camera_name=str(path),
        source=str(path),
        rgb=cloud.rgb,
        labels=labels,
        notes=cloud.notes,
    )


def _read_names(path: Path) -> dict[int, str]:
    names = _read_json(path, 'it must hold {"1": "003_cracker_box"}')
    try:
        result = {int(label): name for label, name in names.items()}
    except (ValueError, OverflowError) as error:
        raise FrameError(f'{path}: keys must be label numbers like "1" ({line(error)})') from error
    wrong = [name for name in result.values() if not isinstance(name, str)]
    if wrong:
        raise FrameError(f"{path}: names must be text, got {wrong[0]!r}")
    return {label: printable(name) for label, name in result.items()}


def _read_json(path: Path, hint: str) -> dict[str, Any]:
    content = read_json(path, hint, FrameError)
    if not isinstance(content, dict):
        raise FrameError(f"{path}: must hold a JSON object; {hint}")
    return content
