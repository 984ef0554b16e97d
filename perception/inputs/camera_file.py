"""Camera and pose files: JSON, YAML, text, .npy and .mat. Knows how they are stored, not what their keys
mean."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mapping.errors import FrameError
from mapping.guarded_files import BROKEN, LARGEST_JSON, check_plain, line, read_json
from perception.image_io import read_array
from perception.inputs.camera_keys import CameraFile, camera_from_keys, matrix_of
from perception.inputs.pose import in_opencv_axes, read_pose

CAMERA_STEMS = (
    "camera",
    "camera_info",
    "intrinsics",
    "intrinsic",
    "camera_intrinsics",
    "camera_intrinsic",
    "K",
    "cam_K",
)
POSE_STEMS = ("pose", "T_world_camera", "camera_pose", "cam_pose", "cam2world", "camera_to_world")
SUFFIXES = (".json", ".yaml", ".yml", ".txt", ".npy", ".mat")
HINT = 'it must hold {"K": 3x3, "width", "height", "depth_scale"}'


def find_file(folder: Path, stems: tuple[str, ...], suffixes: tuple[str, ...]) -> Path | None:
    """The first file of the folder with one of these stems and suffixes."""
    return next(
        (path for stem in stems for end in suffixes if (path := folder / (stem + end)).exists()), None
    )


def read_camera(path: Path, entry: str | None = None) -> CameraFile:
    """The camera of a file in any form camera_from_keys knows, or of K, or of fx fy cx cy alone.

    entry: the key of one image where the file holds many (BOP's scene_camera.json). Raises FrameError.
    """
    content = read_content(path, HINT)
    if isinstance(content, np.ndarray):
        return CameraFile(matrix_of(content, f"{path}: K"))
    if isinstance(content, list) and content:
        return CameraFile(matrix_of(content, f"{path}: K"))
    if not isinstance(content, Mapping):
        raise FrameError(f"{path}: must hold a JSON object; {HINT}")
    if content and all(str(key).isdigit() for key in content):
        if entry is None and len(content) > 1:
            raise FrameError(f"{path}: holds {len(content)} images; read it with --bop DIR SCENE IMAGE")
        key = next(iter(content)) if entry is None else entry
        if key not in content:
            raise FrameError(f"{path}: holds no image {key}; it has {_some(content)}")
        content = content[key]
    return camera_from_keys(content, str(path))


def read_pose_file(path: Path, axes: str = "opencv") -> np.ndarray:
    """T_world_camera (4, 4), OpenCV axes, from JSON, YAML, text or .npy: see perception.inputs.pose."""
    content = read_content(path, "it must hold a pose")
    if isinstance(content, Mapping) and not {"position", "translation", "pose"} & set(content):
        camera = camera_from_keys({"K": np.eye(3), **content}, str(path))
        if camera.T_world_camera is None:
            raise FrameError(f"{path}: holds no pose; it must have T_world_camera")
        return camera.T_world_camera
    return in_opencv_axes(read_pose(content, str(path)), axes, str(path))


def read_content(path: Path, hint: str) -> Any:
    """A mapping, a list or an array, whatever the file holds. Raises FrameError."""
    if path.suffix == ".npy":
        return read_array(path)
    if path.suffix == ".mat":
        return _read_mat(path)
    if path.suffix not in (".txt", ".yaml", ".yml"):
        return read_json(path, hint, FrameError)
    if check_plain(path, hint, FrameError) > LARGEST_JSON:
        raise FrameError(f"{path}: too large for a camera file; {hint}")
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except BROKEN as error:
        raise FrameError(f"{path}: not readable as text ({line(error)}); {hint}") from error
    return _read_text(path, text) if path.suffix == ".txt" else _read_yaml(path, text, hint)


def _read_yaml(path: Path, text: str, hint: str) -> Any:
    import yaml

    # OpenCV's FileStorage begins with a directive and tags that plain YAML refuses.
    plain = "\n".join(
        line.split("!!opencv-matrix")[0] for line in text.splitlines() if not line.startswith("%YAML")
    )
    try:
        documents = [entry for entry in yaml.safe_load_all(plain) if entry is not None]
    except (yaml.YAMLError, RecursionError) as error:
        raise FrameError(f"{path}: not readable as YAML ({line(error)}); {hint}") from error
    if not documents:
        raise FrameError(f"{path}: is empty; {hint}")
    return documents[0]  # `ros2 topic echo` parts messages by ---


def _read_text(path: Path, text: str) -> np.ndarray:
    try:
        rows = [
            [float(word) for word in line.replace(",", " ").split()]
            for line in text.splitlines()
            if line.strip()
        ]
        numbers = np.array(rows)
    except ValueError as error:
        raise FrameError(f"{path}: must hold rows of numbers ({line(error)})") from error
    return numbers[0] if numbers.ndim == 2 and len(numbers) == 1 else numbers


def _read_mat(path: Path) -> dict[str, Any]:
    from scipy.io import loadmat

    check_plain(path, error=FrameError)
    try:
        content = loadmat(str(path), squeeze_me=True)
    except BROKEN as error:
        raise FrameError(f"{path}: not a readable .mat file ({line(error)})") from error
    found = {key: value for key, value in content.items() if not key.startswith("__")}
    return {
        key: value.item() if np.ndim(value) == 0 and hasattr(value, "item") else value
        for key, value in found.items()
    }


def _some(content: Mapping[str, Any]) -> str:
    names = list(map(str, content))
    return ", ".join(names[:5]) + (f", ... ({len(names)} in all)" if len(names) > 5 else "")
