"""Camera poses in the forms people have: matrices, quaternions, the inverse, OpenGL axes. Knows no files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mapping.errors import FrameError
from perception.camera import invert_rigid

OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
"""From OpenGL's camera axes (x right, y up, z backwards) to OpenCV's (x right, y down, z forward), and
back."""
UNIT_TOLERANCE = 0.01
"""A quaternion's length may differ from 1 by this much."""
FORMS = "4x4 rows, 3x4 rows, x y z qx qy qz qw, or {position, orientation {x, y, z, w}}"
"""What read_pose takes, for messages."""

POSITION = ("position", "translation", "t", "origin")
ROTATION = ("orientation", "rotation", "quaternion", "quaternion_xyzw", "quaternion_wxyz", "R", "q")


def read_pose(value: Any, name: str) -> np.ndarray:
    """T (4, 4) from a matrix (4x4, 3x4, 16 or 12 numbers by rows), 7 numbers, or position and orientation.

    A list of four numbers is a quaternion x, y, z, w unless its key says wxyz. Raises FrameError.
    """
    if isinstance(value, Mapping):
        return _from_parts(value, name)
    numbers = _numbers(value, name)
    if numbers.shape == (7,):
        return compose(quaternion_matrix(numbers[3:], name), numbers[:3])
    if numbers.shape in ((4, 4), (3, 4), (16,), (12,)):
        T = np.eye(4)
        T[: numbers.size // 4] = numbers.reshape(-1, 4)
        if np.allclose(T[:3, 3], 0) and np.abs(T[3, :3]).max() > 1e-6 and abs(T[3, 3] - 1) < 1e-6:
            raise FrameError(
                f"{name} is transposed: its translation stands in the last row; write it by rows"
            )
        return T
    raise FrameError(f"{name} must be a pose ({FORMS}), got shape {numbers.shape}")


def compose(R: np.ndarray, t: np.ndarray) -> np.ndarray:
    """T (4, 4) from a rotation (3, 3) and a translation (3,)."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, t
    return T


def quaternion_matrix(q: np.ndarray, name: str) -> np.ndarray:
    """Rotation (3, 3) of a unit quaternion x, y, z, w; raises FrameError when its length is not 1."""
    length = float(np.linalg.norm(q))
    if abs(length - 1) > UNIT_TOLERANCE:
        raise FrameError(f"{name}: a quaternion has length 1, this one {length:.3g}; order it x, y, z, w")
    x, y, z, w = q / length
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def in_opencv_axes(T_world_camera: np.ndarray, axes: str, name: str) -> np.ndarray:
    """The pose with OpenCV's camera axes; axes: "opencv" or "opengl" (also "blender"), as it was given."""
    word = str(axes).lower()
    if word == "opencv":
        return T_world_camera
    if word in ("opengl", "blender"):
        return np.asarray(T_world_camera @ OPENGL)
    raise FrameError(f'{name}: axes must be "opencv" or "opengl", got {axes!r}')


def inverse(T: np.ndarray, name: str) -> np.ndarray:
    """The inverse of a rigid pose; FrameError when it is not rigid."""
    if np.abs(T[:3, :3] @ T[:3, :3].T - np.eye(3)).max() > 1e-3:
        raise FrameError(f"{name} is not a rigid transform (rotation not orthonormal or scaled)")
    return invert_rigid(T)


def _from_parts(value: Mapping[str, Any], name: str) -> np.ndarray:
    if "pose" in value and len(value) <= 2:  # ROS PoseStamped
        return _from_parts(value["pose"], name)
    where = next((key for key in POSITION if key in value), None)
    turn = next((key for key in ROTATION if key in value), None)
    if where is None or turn is None:
        raise FrameError(f"{name} must be a pose ({FORMS}), got the keys {', '.join(map(str, value))}")
    t = _vector(value[where], "xyz", f"{name}.{where}")
    return compose(rotation_of(value[turn], turn, f"{name}.{turn}"), t)


def rotation_of(value: Any, key: str, name: str) -> np.ndarray:
    """Rotation (3, 3) from 3x3, 9 numbers by rows, or a quaternion; the key tells its order (xyzw, or
    wxyz)."""
    if isinstance(value, Mapping):
        return quaternion_matrix(_vector(value, "xyzw", name), name)
    numbers = _numbers(value, name)
    if numbers.size == 4:
        q = numbers.reshape(4)
        return quaternion_matrix(np.roll(q, -1) if key.endswith("wxyz") else q, name)
    if numbers.size == 9:
        return numbers.reshape(3, 3)
    raise FrameError(f"{name} must be 3x3 or a quaternion x, y, z, w, got {numbers.size} numbers")


def _vector(value: Any, letters: str, name: str) -> np.ndarray:
    if isinstance(value, Mapping):
        lacking = [letter for letter in letters if letter not in value]
        if lacking:
            raise FrameError(f"{name} lacks {', '.join(lacking)}")
        value = [value[letter] for letter in letters]
    numbers = _numbers(value, name).reshape(-1)
    if numbers.size != len(letters):
        raise FrameError(f"{name} must hold {len(letters)} numbers, got {numbers.size}")
    return numbers


def _numbers(value: Any, name: str) -> np.ndarray:
    try:
        numbers = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise FrameError(f"{name} must hold numbers ({FORMS})") from error
    if not np.isfinite(numbers).all():
        raise FrameError(f"{name} holds NaN or infinite values")
    return numbers
