"""The pinhole camera: projection undoes back-projection, poses are checked."""

import numpy as np
import pytest

from mapping import FrameError
from perception import Camera
from perception.camera import invert_rigid, transform

K = np.array([[300.0, 0.5, 80.0], [0.0, 310.0, 60.0], [0.0, 0.0, 1.0]])


def random_pose(seed: int) -> np.ndarray:
    generator = np.random.default_rng(seed)
    Q, _ = np.linalg.qr(generator.normal(size=(3, 3)))
    T = np.eye(4)
    T[:3, :3] = Q * np.sign(np.linalg.det(Q))
    T[:3, 3] = generator.normal(size=3)
    return T


def test_projection_undoes_back_projection() -> None:
    camera = Camera(K, 160, 120)
    depth = np.random.default_rng(0).uniform(0.3, 2.0, (120, 160)).astype(np.float32)
    uv, z = camera.project(camera.back_project(depth).reshape(-1, 3))
    column, row = np.meshgrid(np.arange(160), np.arange(120))
    np.testing.assert_allclose(uv, np.stack([column.ravel(), row.ravel()], axis=1), atol=2e-4)
    np.testing.assert_allclose(z, depth.ravel(), rtol=1e-6)


def test_missing_depth_stays_missing() -> None:
    depth = np.full((120, 160), np.nan, np.float32)
    assert np.isnan(Camera(K, 160, 120).back_project(depth)).all()


@pytest.mark.parametrize("seed", range(3))
def test_inverse_of_a_rigid_transform(seed: int) -> None:
    T = random_pose(seed)
    points = np.random.default_rng(seed).normal(size=(50, 3))
    np.testing.assert_allclose(transform(invert_rigid(T), transform(T, points)), points, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"K": np.full((3, 3), np.nan)}, "NaN"),
        ({"K": np.diag([-300.0, 300.0, 1.0])}, "focal lengths"),
        ({"K": np.diag([300.0, 0.0, 1.0])}, "focal lengths"),
        ({"K": np.array([[300.0, 0, 1600], [0, 300.0, 60], [0, 0, 1]])}, "principal point"),
        ({"K": np.eye(4)}, "shape"),
        ({"K": "wide"}, "numbers"),
        ({"T_world_camera": 2 * np.eye(4)}, "rigid"),
        ({"T_world_camera": np.diag([1.0, 1.0, -1.0, 1.0])}, "rigid"),
        ({"T_world_camera": np.full((4, 4), np.inf)}, "infinite"),
    ],
)
def test_bad_cameras_are_refused(change: dict, message: str) -> None:
    with pytest.raises(FrameError, match=message):
        Camera(**{"K": K, "width": 160, "height": 120, **change})
