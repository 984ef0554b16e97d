"""The camera's pose against the support plane: its normal points up in a level world, its height is in
metres."""

from __future__ import annotations

import numpy as np

from mapping.errors import FrameError
from perception.camera import Camera
from perception.inputs.pose import OPENGL
from perception.observation import SupportPlane

LEVEL = np.cos(np.radians(6.0))
"""A support within this angle of an axis of the world is level, or upright."""
TOLD = np.cos(np.radians(4.0))
"""Another reading of the pose is believed within this angle of upwards."""
TILTED = np.cos(np.radians(45.0))
"""A support tilted less than this is worth a note: a world that is meant to be level is not."""
MILLIMETRES = (20.0, 5000.0)
"""A translation between these, in metres, may have been written in millimetres."""
AT_ZERO = 0.03
"""In millimetres, the table then lies this near to z = 0 [m] ..."""
TABLE_HEIGHTS = (-0.1, 1.5)
"""... or at the height of a table or shelf above the floor [m], which is worth a note only."""
MENDS = {
    "opengl": 'the pose has OpenGL axes (y up, z backwards); set "axes": "opengl" in the camera file',
    "inverse": "the pose is world to camera; write its inverse, or call it T_camera_world",
    "inverse, opengl": 'the pose is world to camera in OpenGL axes: name it T_camera_world, "axes": "opengl"',
}


def check_pose(camera: Camera, support: SupportPlane, source: str, trusted: bool) -> list[str]:
    """Notes about the pose; raises FrameError when the support tells that it was given in another way."""
    R, t = camera.T_world_camera[:3, :3], camera.T_world_camera[:3, 3]
    if trusted or np.allclose(camera.T_world_camera, np.eye(4)):
        return []
    normal = support.normal / np.linalg.norm(support.normal)
    up = R @ normal
    flip = OPENGL[:3, :3]
    notes: list[str] = []
    if up[2] > LEVEL:
        return _check_metres(float(t[2]), float(support.offset), t, source)
    if np.allclose(R, np.eye(3), atol=1e-6):
        return []
    readings = {"opengl": R @ flip @ normal, "inverse": R.T @ normal, "inverse, opengl": R.T @ flip @ normal}
    told = [kind for kind, direction in readings.items() if direction[2] > TOLD]
    upright = max(abs(up[0]), abs(up[1])) > LEVEL  # a world whose y or x points up
    if told and not upright:
        angle = np.degrees(np.arccos(np.clip(up[2], -1, 1)))
        raise FrameError(
            f"{source}: T_world_camera: the table's normal lies {angle:.0f} degrees off the world's z; "
            f"{MENDS[told[0]]}; if "
            'the pose is right, add "trust": ["pose"] (--trust pose)'
        )
    if not upright and up[2] > TILTED:
        angle = np.degrees(np.arccos(up[2]))
        notes.append(f"the table tilts {angle:.0f} degrees against z of the world: right if z is not up")
    return notes


def _check_metres(height: float, over_table: float, t: np.ndarray, source: str) -> list[str]:
    """Whether the translation t (3,) is in millimetres. over_table: the camera's height above the table
    [m]."""
    farthest = float(np.abs(t).max())
    if not MILLIMETRES[0] < farthest < MILLIMETRES[1]:
        return []
    table = height / 1000 - over_table
    if abs(table) < AT_ZERO:
        raise FrameError(
            f"{source}: T_world_camera puts the camera {farthest:.0f} m from the origin; in millimetres "
            f"the table would lie at "
            'z = 0: divide its translation by 1000, or add "trust": ["pose"] (--trust pose)'
        )
    if TABLE_HEIGHTS[0] < table < TABLE_HEIGHTS[1]:
        return [
            f"T_world_camera puts the camera {farthest:.0f} m from the origin: if that is millimetres, "
            f"divide by 1000"
        ]
    return []
