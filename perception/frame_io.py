"""Frames from and to files: the frame folder, one .npz, or separate images. Every refusal names the file."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mapping.errors import FrameError
from mapping.guarded_files import line, names_of_npz, printable, read_json, read_npz
from perception.camera import Camera
from perception.frame import Frame
from perception.image_io import read_array, read_depth_image, read_labels, read_rgb, write_png, write_whole

NPZ_LABELS = ("segmap", "seg", "labels")
"""Names under which an .npz may hold its instance labels."""


def load_frame(path: str | os.PathLike[str]) -> Frame:
    """Load a frame folder or one .npz file with depth [m], K and optionally segmap or seg, and rgb.

    Raises FrameError that names the file, what is wrong with it and how to mend it.
    """
    source = Path(path)
    if source.is_dir():
        return _load_folder(source)
    if not source.exists():
        raise FrameError(f"{source}: no such frame; give a frame folder or an .npz file")
    if source.suffix == ".npz":
        return _load_npz(source)
    raise FrameError(f"{source}: not a frame; give a folder with depth.png and camera.json, or an .npz file")


def load_images(
    rgb: str | os.PathLike[str] | None,
    depth: str | os.PathLike[str],
    labels: str | os.PathLike[str] | None,
    intrinsics: Sequence[float] | np.ndarray,
    depth_scale: float = 0.001,
    *,
    T_world_camera: np.ndarray | None = None,
    names: dict[int, str] | None = None,
) -> Frame:
    """Load a frame from separate files.

    depth: 16-bit PNG, or .npy in metres (depth_scale is then not used). intrinsics: fx, fy, cx, cy [px]
    or K (3, 3). depth_scale: metres per unit of the depth image. Raises FrameError.
    """
    values = np.asarray(intrinsics, dtype=np.float64)
    if values.shape == (4,):
        fx, fy, cx, cy = values
        values = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    elif values.shape != (3, 3):
        raise FrameError(f"intrinsics must be FX FY CX CY or a 3x3 K, got shape {values.shape}")
    depth_path = Path(depth)
    metres = _read_depth(depth_path, depth_scale, "--depth-scale")
    pose = np.eye(4) if T_world_camera is None else np.asarray(T_world_camera)
    camera = Camera(values, metres.shape[1], metres.shape[0], pose)
    return _assemble(
        metres,
        depth_path,
        camera,
        None if rgb is None else Path(rgb),
        None if labels is None else Path(labels),
        names or {},
        str(depth_path),
    )


def save_frame(frame: Frame, folder: str | os.PathLike[str], depth_scale: float = 0.001) -> None:
    """Write a frame folder with depth as 16-bit PNG in units of depth_scale [m].

    Depth beyond 65535 units is written as missing. Each file is written under a temporary name and
    renamed, camera.json last, so a folder with camera.json is complete.
    """
    target = Path(folder)
    _check_scale(depth_scale, target / "camera.json", "depth_scale")
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


def _load_folder(folder: Path) -> Frame:
    camera_path = folder / "camera.json"
    settings = _read_json(camera_path, 'it must hold {"K": 3x3, "width", "height", "depth_scale"}')
    missing = [key for key in ("K", "width", "height") if key not in settings]
    if missing:
        raise FrameError(
            f"{camera_path}: lacks {', '.join(missing)}; it must hold K (3x3), width, height and depth_scale"
        )
    for key in ("width", "height"):
        if not isinstance(settings[key], int) or isinstance(settings[key], bool) or settings[key] <= 0:
            raise FrameError(
                f"{camera_path}: {key} must be a whole number of pixels > 0, got {settings[key]!r}"
            )
    pose = settings.get("T_world_camera")
    try:
        camera = Camera(
            settings["K"], settings["width"], settings["height"], np.eye(4) if pose is None else pose
        )
    except FrameError as error:
        raise FrameError(f"{camera_path}: {error}") from error
    depth_path = folder / "depth.npy"
    if depth_path.exists():
        depth = _read_depth(depth_path, 1.0, "depth_scale")
    else:
        depth_path = folder / "depth.png"
        if not depth_path.exists():
            raise FrameError(
                f"{folder}: holds neither depth.png (16-bit) nor depth.npy (float metres); add one of them"
            )
        if "depth_scale" not in settings:
            raise FrameError(
                f"{camera_path}: lacks depth_scale, the metres per unit of depth.png (0.001 for millimetres)"
            )
        depth = _read_depth(depth_path, settings["depth_scale"], f"depth_scale of {camera_path}")
    rgb, labels = folder / "rgb.png", folder / "labels.png"
    names_path = folder / "names.json"
    names = _read_names(names_path) if names_path.exists() else {}
    return _assemble(
        depth,
        depth_path,
        camera,
        rgb if rgb.exists() else None,
        labels if labels.exists() else None,
        names,
        str(folder),
    )


def _assemble(
    depth: np.ndarray,
    depth_path: Path,
    camera: Camera,
    rgb_path: Path | None,
    labels_path: Path | None,
    names: dict[int, str],
    source: str,
) -> Frame:
    expected = (camera.height, camera.width)
    _check_size(depth, depth_path, expected, "camera.json")
    rgb = labels = None
    if rgb_path is not None:
        rgb = read_rgb(rgb_path)
        _check_size(rgb, rgb_path, expected, depth_path.name)
    if labels_path is not None:
        labels = read_labels(labels_path)
        _check_size(labels, labels_path, expected, depth_path.name)
    return Frame(depth, camera, rgb, labels, names, source)


def _load_npz(path: Path) -> Frame:
    arrays = _read_npz(path)
    for key in ("depth", "K"):
        if key not in arrays:
            raise FrameError(
                f"{path}: lacks the array {key!r} (it holds {', '.join(sorted(arrays)) or 'nothing'}); "
                "save depth in metres and K (3x3)"
            )
    depth = arrays["depth"]
    if depth.ndim != 2 or not np.issubdtype(depth.dtype, np.floating):
        raise FrameError(f"{path}: depth must be a 2D float array in metres, got {depth.dtype} {depth.shape}")
    camera = _camera_of(arrays["K"], depth, path)
    found = next((key for key in NPZ_LABELS if key in arrays), None)
    return Frame(depth, camera, arrays.get("rgb"), None if found is None else arrays[found], source=str(path))


def _camera_of(K: np.ndarray, depth: np.ndarray, path: Path) -> Camera:
    try:
        return Camera(K.reshape(3, 3) if K.size == 9 else K, depth.shape[1], depth.shape[0])
    except FrameError as error:
        raise FrameError(f"{path}: {error}") from error


def _read_npz(path: Path) -> dict[str, np.ndarray]:
    wanted = ("depth", "K", "rgb", *NPZ_LABELS)
    arrays = read_npz(path, wanted, FrameError)
    return arrays or dict.fromkeys(names_of_npz(path, FrameError), np.empty(0))


def _read_depth(path: Path, scale: Any, scale_name: str) -> np.ndarray:
    """Depth (H, W) float32 [m] from a 16-bit image or a float .npy file."""
    if path.suffix == ".npy":
        depth = read_array(path)
        if depth.ndim != 2 or not np.issubdtype(depth.dtype, np.floating):
            raise FrameError(
                f"{path}: must be a 2D float array in metres, got {depth.dtype} {depth.shape}; "
                "whole-number depth belongs into a 16-bit depth.png"
            )
        return depth.astype(np.float32)
    factor = _check_scale(scale, path, scale_name)
    return read_depth_image(path).astype(np.float32) * np.float32(factor)


def _check_scale(scale: Any, path: Path, name: str) -> float:
    if isinstance(scale, bool) or not isinstance(scale, (int, float)) or not 0 < scale < float("inf"):
        raise FrameError(
            f"{path}: {name} must be a number > 0 (metres per unit; 0.001 for mm), got {scale!r}"
        )
    return float(scale)


def _check_size(image: np.ndarray, path: Path, expected: tuple[int, int], other: str) -> None:
    if image.shape[:2] != expected:
        raise FrameError(
            f"{path}: is {image.shape[1]}x{image.shape[0]} but {other} says {expected[1]}x{expected[0]}; "
            "register all images to one camera and size"
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


def _write_json(path: Path, content: dict[str, Any]) -> None:
    text = json.dumps(content, indent=1) + "\n"
    write_whole(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))
