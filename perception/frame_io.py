"""Frames from and to files: the frame folder, one .npz or cloud, or separate files. Every refusal names the
file."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mapping.errors import FrameError
from mapping.files import write_atomically
from perception.frame import Frame
from perception.image_io import write_png
from perception.inputs.assemble import Parts, assemble
from perception.inputs.camera_file import read_camera
from perception.inputs.camera_keys import CameraFile, check_scale, check_trust, matrix_of
from perception.inputs.depth_files import read_depth
from perception.inputs.frame_parts import cloud_parts, folder_parts, npz_parts
from perception.inputs.pose import read_pose

MILLIMETRE = 0.001
"""Unit of whole-number depth where none is given [m]."""


def load_frame(
    path: str | os.PathLike[str],
    *,
    depth_scale: float | None = None,
    T_world_camera: Any = None,
    trust: Sequence[str] = (),
) -> Frame:
    """Load a frame folder, one .npz file with depth and K, or an organised cloud (.pcd, .ply).

    depth_scale: metres per unit, T_world_camera: pose in any form of perception.inputs.pose; both go before
    what the files say. trust: what is vouched for ("unit", "kind", "K", "pose"). docs/inputs.md lists all
    forms. Raises FrameError that names the file, what is wrong with it and how to mend it.
    """
    source = Path(path)
    if source.is_dir():
        parts = folder_parts(source)
    elif not source.exists():
        raise FrameError(f"{source}: no such frame; give a frame folder or an .npz file")
    elif source.suffix == ".npz":
        parts = npz_parts(source)
    elif source.suffix in (".pcd", ".ply"):
        parts = cloud_parts(source)
    else:
        raise FrameError(
            f"{source}: not a frame; give a folder with depth.png and camera.json, an .npz file, or an "
            f"organised cloud"
        )
    return assemble(_with_options(parts, depth_scale, T_world_camera, trust))


def load_images(
    rgb: str | os.PathLike[str] | None,
    depth: str | os.PathLike[str],
    labels: str | os.PathLike[str] | None,
    intrinsics: Sequence[float] | np.ndarray | str | os.PathLike[str],
    depth_scale: float | None = None,
    *,
    T_world_camera: Any = None,
    names: dict[int, str] | None = None,
    trust: Sequence[str] = (),
) -> Frame:
    """Load a frame from separate files.

    depth: 16-bit PNG or TIFF, .npy, float TIFF, EXR. labels: an image, an array, a folder of masks, COCO's
    JSON. intrinsics: fx, fy, cx, cy [px], K (3, 3), or a camera file. depth_scale: metres per unit of whole
    numbers (1 mm by default); floats are metres, unless they cannot be and a scale makes metres of them.
    T_world_camera, trust: as for load_frame. Raises FrameError.
    """
    path = Path(depth)
    if isinstance(intrinsics, (str, os.PathLike)):
        camera, camera_name = read_camera(Path(intrinsics)), str(intrinsics)
    else:
        camera, camera_name = CameraFile(_intrinsics(intrinsics)), "intrinsics"
    stored = read_depth(path)
    if depth_scale is None:
        depth_scale = camera.depth_scale or (MILLIMETRE if stored.whole else None)
    else:
        check_scale(depth_scale, path, "--depth-scale")
    parts = Parts(
        depth=stored,
        camera=replace(camera, depth_scale=depth_scale),
        camera_name=camera_name,
        source=str(path),
        rgb=None if rgb is None else Path(rgb),
        labels=None if labels is None else Path(labels),
        names=names or {},
        scale_name="--depth-scale",
    )
    return assemble(_with_options(parts, None, T_world_camera, trust))


def save_frame(frame: Frame, folder: str | os.PathLike[str], depth_scale: float = 0.001) -> None:
    """Write a frame folder with depth as 16-bit PNG in units of depth_scale [m].

    Depth beyond 65535 units is written as missing. Each file is written under a temporary name and
    renamed, camera.json last, so a folder with camera.json is complete. Raises DataError when writing fails.
    """
    target = Path(folder)
    check_scale(depth_scale, target / "camera.json", "depth_scale")
    target.mkdir(parents=True, exist_ok=True)
    for stale in ("camera.json", "depth.npy", "rgb.png", "labels.png", "names.json"):
        (target / stale).unlink(missing_ok=True)
    units = np.rint(np.nan_to_num(frame.depth) / depth_scale)
    write_png(target / "depth.png", np.where(units <= 65535, units, 0).astype(np.uint16))
    if frame.rgb is not None:
        write_png(target / "rgb.png", frame.rgb)
    if frame.labels is not None:
        write_png(target / "labels.png", frame.labels)
    if frame.names:
        _write_json(target / "names.json", {str(label): name for label, name in frame.names.items()})
    _write_json(
        target / "camera.json",
        {
            "K": frame.camera.K.tolist(),
            "width": frame.camera.width,
            "height": frame.camera.height,
            "depth_scale": depth_scale,
            "T_world_camera": frame.camera.T_world_camera.tolist(),
        },
    )


def _with_options(parts: Parts, depth_scale: float | None, pose: Any, trust: Sequence[str]) -> Parts:
    """The parts with what the caller says himself, which goes before what the files say."""
    check_trust(trust, parts.source)
    camera = replace(parts.camera, trust=(*parts.camera.trust, *trust))
    if pose is not None:
        camera = replace(camera, T_world_camera=read_pose(pose, "T_world_camera"))
    if depth_scale is not None:
        scale = check_scale(depth_scale, parts.source, "depth_scale")
        return replace(parts, camera=replace(camera, depth_scale=scale), scale_floats=True)
    return replace(parts, camera=camera)


def _intrinsics(values: Any) -> np.ndarray:
    numbers = np.asarray(values, dtype=np.float64)
    if numbers.shape not in ((4,), (3, 3), (9,)):
        raise FrameError(f"intrinsics must be FX FY CX CY or a 3x3 K, got shape {numbers.shape}")
    return matrix_of(numbers, "intrinsics")


def _write_json(path: Path, content: dict[str, Any]) -> None:
    text = json.dumps(content, indent=1) + "\n"
    write_atomically(path, text.encode())
