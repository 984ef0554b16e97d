"""A camera from named values, whoever chose the names: ROS, RealSense, Open3D, BOP, flat K. Knows no files.

Every key is either understood, known to be of no use, or named in a note: nothing is passed over in silence.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mapping.errors import FrameError
from perception.inputs.camera_words import (
    AXES,
    COLOR,
    COLOR_FROM_DEPTH,
    DEPTH,
    DEPTH_FROM_COLOR,
    DISTORTION,
    FACTOR,
    FROM_WORLD,
    HEIGHT,
    KIND,
    KINDS,
    LARGEST_SCALE,
    LETTERS,
    MATRIX,
    MODEL,
    SCALE,
    SIZE,
    TO_WORLD,
    TRUST,
    UNIT_WORDS,
    UNSAID,
    WIDTH,
    Keys,
)
from perception.inputs.distortion import Distortion, read_distortion
from perception.inputs.pose import compose, in_opencv_axes, inverse, read_pose, rotation_of


@dataclass(frozen=True)
class CameraFile:
    """What a camera file says. K (3, 3) [px]; width, height [px] or None; depth_scale [m per unit] or None.

    T_world_camera: (4, 4) [m], OpenCV axes, or None. trust: what the file vouches for, see Frame.
    depth_kind: "z", or "ray" for the length of the ray. color: the camera of colour and labels, where it is
    another one, and T_color_depth (4, 4) [m]. notes: one line for each thing worth saying.
    """

    K: np.ndarray
    width: int | None = None
    height: int | None = None
    depth_scale: float | None = None
    T_world_camera: np.ndarray | None = None
    trust: tuple[str, ...] = ()
    distortion: Distortion | None = None
    depth_kind: str = "z"
    color: CameraFile | None = None
    T_color_depth: np.ndarray | None = None
    notes: tuple[str, ...] = ()


def camera_from_keys(content: Mapping[str, Any], name: str) -> CameraFile:
    """The camera that named values describe; name: for messages. Raises FrameError naming the key at
    fault."""
    keys = Keys(content, name)
    if (inner := keys.take(DEPTH)) is not None and isinstance(inner, Mapping):
        main = camera_from_keys(inner, f"{name}: depth")
    elif isinstance(inner := content.get("intrinsic"), Mapping):  # Open3D's PinholeCameraParameters
        keys.take(("intrinsic",))
        main = camera_from_keys(inner, f"{name}: intrinsic")
    else:
        main = _one_camera(keys, bop="cam_K" in content)
    trust = _trust(keys)
    pose, said = _pose(keys, open3d=content.get("class_name") == "PinholeCameraParameters")
    if said:
        trust = (*trust, "pose")
    kind = str(keys.take(KIND) or main.depth_kind)
    if kind not in KINDS:
        raise FrameError(
            f'{name}: {keys.spelling(KIND)} must be "z" or "ray" (length of the ray), got {kind!r}'
        )
    color, T_color_depth = _color(keys)
    scale = _scale(keys, bop="cam_K" in content or _flat_bop(content))
    notes = main.notes
    if unknown := keys.unknown():
        notes = (*notes, f"{name}: not understood and not used: {', '.join(unknown)}")
    return replace(
        main,
        depth_scale=main.depth_scale if scale is None else scale,
        T_world_camera=main.T_world_camera if pose is None else pose,
        trust=(*main.trust, *trust),
        depth_kind=kind,
        color=color,
        T_color_depth=T_color_depth,
        notes=notes,
    )


def matrix_of(value: Any, name: str, columns: bool = False) -> np.ndarray:
    """K (3, 3) from 3x3, 9 numbers by rows (by columns where the format says so), or fx, fy, cx, cy."""
    if isinstance(value, Mapping):
        value = value.get("data", value)
    if isinstance(value, Mapping):
        return camera_from_keys(value, name).K
    try:
        numbers = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise FrameError(f"{name} must be a 3x3 matrix of numbers, or fx, fy, cx, cy") from error
    if numbers.shape == (4,):
        fx, fy, cx, cy = numbers
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    if numbers.size == 9:
        K = numbers.reshape(3, 3)
        return K.T.copy() if columns else K
    if numbers.shape == (3, 4):
        return numbers[:3, :3].copy()
    raise FrameError(f"{name} must have shape (3, 3), or be fx, fy, cx, cy; got {numbers.shape}")


def _one_camera(keys: Keys, bop: bool) -> CameraFile:
    """Intrinsics, size and distortion of one camera."""
    name = keys.name
    if any(key in keys.content for key in MATRIX):
        spelt = keys.spelling(MATRIX)
        value = keys.take(MATRIX)
        # Open3D writes its intrinsic_matrix by columns.
        by_columns = (
            spelt == "intrinsic_matrix" and np.ndim(value) == 1 and {"width", "height"} <= set(keys.content)
        )
        K = matrix_of(value, f"{name}: {spelt}", by_columns)
        for alias in ("fx", "fy", "cx", "cy"):
            keys.take((alias,))
    elif {"fx", "fy"} <= set(keys.content):
        K = _flat(keys)
    elif any(key in keys.content for key in ("p", "projectionmatrix")):
        K = matrix_of(_reshaped(keys.take(("p", "projectionmatrix"))), f"{name}: P")
    else:
        raise FrameError(f"{name}: lacks K; it must hold K (3x3) or fx, fy, cx, cy, and width and height")
    size = keys.take(SIZE)
    width, height = keys.take(WIDTH), keys.take(HEIGHT)
    if size is not None and width is None and np.size(size) == 2:
        width, height = (int(side) for side in size)
    for key, side in (("width", width), ("height", height)):
        if side is not None and (isinstance(side, bool) or not isinstance(side, int) or side <= 0):
            raise FrameError(f"{name}: {key} must be a whole number of pixels > 0, got {side!r}")
    model = keys.take(MODEL)
    given = keys.take(DISTORTION)
    if isinstance(given, Mapping):
        given = given.get("data", [given.get(letter, 0.0) for letter in LETTERS[:5]])
    if given is None and any(letter in keys.content for letter in LETTERS):
        given = [keys.take((letter,)) or 0.0 for letter in LETTERS]
        given = given[:5] if not any(given[5:]) else given
    distortion = None if given is None else read_distortion(given, model, name)
    return CameraFile(K, width, height, distortion=distortion)


def _flat(keys: Keys) -> np.ndarray:
    lacking = [
        pair[0] for pair in (("cx", "ppx"), ("cy", "ppy")) if not any(key in keys.content for key in pair)
    ]
    if lacking:
        raise FrameError(f"{keys.name}: lacks {', '.join(lacking)} beside fx and fy")
    fx, fy, cx, cy = (keys.take(names) for names in (("fx",), ("fy",), ("cx", "ppx"), ("cy", "ppy")))
    return matrix_of([fx, fy, cx, cy], f"{keys.name}: fx, fy, cx, cy")


def _reshaped(value: Any) -> Any:
    data = value.get("data", value) if isinstance(value, Mapping) else value
    return np.reshape(data, (3, 4)) if np.size(data) == 12 else data


def _flat_bop(content: Mapping[str, Any]) -> bool:
    """Whether this is a BOP data set's camera.json, whose depth_scale counts in millimetres."""
    wanted = {"cx", "cy", "fx", "fy", "width", "height", "depth_scale"}
    scale = content.get("depth_scale")
    return set(content) == wanted and isinstance(scale, (int, float)) and scale >= LARGEST_SCALE


def _scale(keys: Keys, bop: bool) -> float | None:
    factor, scale = keys.take(FACTOR), keys.take(SCALE)
    if isinstance(scale, str) and scale.lower() in UNIT_WORDS:
        return UNIT_WORDS[scale.lower()]
    if factor is not None and scale is None:
        spelt = keys.spelling(FACTOR)
        factor = float(np.squeeze(factor)) if np.size(factor) == 1 and not isinstance(factor, str) else factor
        return 1 / check_scale(factor, keys.name, spelt, "units per metre; 1000 for mm")
    if scale is None:
        return None
    value = check_scale(scale, keys.name, keys.spelling(SCALE))
    return value / 1000 if bop else value


def check_scale(
    scale: Any, where: object, name: str, meaning: str = "metres per unit; 0.001 for mm"
) -> float:
    """The scale as a float; FrameError unless it is a number > 0."""
    if isinstance(scale, bool) or not isinstance(scale, (int, float)) or not 0 < scale < float("inf"):
        raise FrameError(f"{where}: {name} must be a number > 0 ({meaning}), got {scale!r}")
    return float(scale)


def _trust(keys: Keys) -> tuple[str, ...]:
    given = keys.take(("trust",))
    words = [given] if isinstance(given, str) else list(given or [])
    check_trust(words, keys.name)
    return tuple(words)


def check_trust(words: Sequence[Any], name: str) -> None:
    """Raise FrameError for a word that is not in TRUST."""
    if wrong := [word for word in words if word not in TRUST]:
        raise FrameError(f"{name}: trust can hold {', '.join(TRUST)}, got {wrong[0]!r}")


def _pose(keys: Keys, open3d: bool) -> tuple[np.ndarray | None, bool]:
    """T_world_camera (4, 4) in OpenCV axes or None, and whether the axes are named."""
    axes = keys.take(AXES)
    if {"camrw2c", "camtw2c"} <= set(keys.content):  # BOP, translation in mm
        R = rotation_of(keys.take(("camrw2c",)), "R", f"{keys.name}: cam_R_w2c")
        t = np.reshape(keys.take(("camtw2c",)), 3).astype(float) / 1000
        return inverse(compose(R, t), f"{keys.name}: cam_R_w2c"), True
    if open3d and "extrinsic" in keys.content:
        numbers = np.reshape(keys.take(("extrinsic",)), (4, 4)).T
        return inverse(read_pose(numbers, f"{keys.name}: extrinsic"), f"{keys.name}: extrinsic"), True
    if any(key in keys.content for key in TO_WORLD):
        name = f"{keys.spelling(TO_WORLD)} of {keys.name}"
        value = keys.take(TO_WORLD)
        if value is None:
            return None, False
        pose = _matrix_shape(value, name)
    elif any(key in keys.content for key in FROM_WORLD):
        name = f"{keys.spelling(FROM_WORLD)} of {keys.name}"
        pose = inverse(_matrix_shape(keys.take(FROM_WORLD), name), name)
    elif any(key in keys.content for key in UNSAID):
        raise FrameError(
            f"{keys.name}: {keys.spelling(UNSAID)!r} does not say which way it goes; call it T_world_camera "
            "(camera to world) or T_camera_world (world to camera)"
        )
    elif any(key in keys.content for key in ("position", "translation")) and any(
        key in keys.content for key in ("orientation", "quaternion", "rotation")
    ):
        parts = {"position": keys.take(("position", "translation"))}
        parts["orientation"] = keys.take(("orientation", "quaternion", "rotation"))
        name, pose = keys.name, read_pose(parts, keys.name)
    else:
        return None, False
    return in_opencv_axes(pose, axes or "opencv", name), axes is not None


def _matrix_shape(value: Any, name: str) -> np.ndarray:
    """A pose; what is no pose is told by the name of its key alone, as Camera tells it."""
    return read_pose(value, name)


def _color(keys: Keys) -> tuple[CameraFile | None, np.ndarray | None]:
    inner = keys.take(COLOR)
    color = camera_from_keys(inner, f"{keys.name}: color") if isinstance(inner, Mapping) else None
    forward, backward = keys.take(COLOR_FROM_DEPTH), keys.take(DEPTH_FROM_COLOR)
    name = f"{keys.name}: T_color_depth"
    if forward is not None:
        return color, _stereo(forward, name)
    if backward is not None:
        return color, inverse(_stereo(backward, f"{keys.name}: T_depth_color"), name)
    return color, None


def _stereo(value: Any, name: str) -> np.ndarray:
    """The pose between two cameras; RealSense writes its 9 numbers of rotation by columns."""
    if isinstance(value, Mapping) and np.size(value.get("rotation", ())) == 9 and "translation" in value:
        numbers = np.array(value["rotation"], dtype=np.float64)
        R = numbers.reshape(3, 3).T if numbers.ndim == 1 else numbers
        return compose(R, np.reshape(value["translation"], 3).astype(float))
    return read_pose(value, name)
