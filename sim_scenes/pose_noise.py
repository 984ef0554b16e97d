"""What an arm or a tracker gets wrong about where the camera is. Knows poses only."""

from __future__ import annotations

import numpy as np

from mapping.errors import ConfigError

DEGREES_A_METRE = 200.0
"""Where one figure is given for both: 10 mm go with 2 degrees."""


def noisy_pose(T: np.ndarray, shift: float, turn: float, rng: np.random.Generator) -> np.ndarray:
    """T_world_camera (4, 4) with an error of random direction and a size evenly drawn: moved by up to `shift`
    [m], turned about its own place by up to `turn` [degrees]."""
    from scipy.spatial.transform import Rotation

    direction, axis = rng.standard_normal((2, 3))
    sizes = rng.uniform(0, 1, 2) * (shift, np.radians(turn))
    wrong = np.array(T, float)
    wrong[:3, 3] += sizes[0] * direction / np.linalg.norm(direction)
    wrong[:3, :3] = Rotation.from_rotvec(sizes[1] * axis / np.linalg.norm(axis)).as_matrix() @ wrong[:3, :3]
    return wrong


def check_pose_noise(noise: tuple[float, float] | None) -> None:
    """Raise ConfigError when (metres, degrees) are no sizes of an error."""
    if noise is not None and not (0 <= noise[0] <= 1 and 0 <= noise[1] <= 180):
        raise ConfigError(f"pose noise must be metres in 0..1 and degrees in 0..180, got {noise}")
