"""Depth of another size, a baseline, lens distortion: labels find their pixels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from many_words import (
    base,
    content,
    put,
)
from PIL import Image

from perception import Camera, Frame, load_frame


def doubled(frame: Frame) -> Frame:
    """The frame at twice the resolution, every pixel four times."""
    K = frame.camera.K.copy()
    K[:2] *= 2
    K[:2, 2] += 0.5
    big = [
        None if image is None else image.repeat(2, 0).repeat(2, 1)
        for image in (frame.depth, frame.rgb, frame.labels)
    ]
    height, width = big[0].shape
    return Frame(big[0], Camera(K, width, height, frame.camera.T_world_camera), big[1], big[2], frame.names)


def test_depth_of_another_size_finds_its_labels_by_the_extrinsics(
    tabletop_frame: Frame, tmp_path: Path
) -> None:
    large = doubled(tabletop_frame)
    T_color_depth = np.eye(4)
    folder = base(tabletop_frame, tmp_path / "frame")
    assert large.labels is not None
    Image.fromarray(large.labels).save(folder / "labels.png")
    Image.fromarray(large.rgb).save(folder / "rgb.png")
    color = {"K": large.camera.K.tolist(), "width": large.camera.width, "height": large.camera.height}
    for extrinsics in (
        {"T_color_depth": T_color_depth.tolist()},
        {"depth_to_color": {"rotation": np.eye(3).reshape(-1).tolist(), "translation": [0, 0, 0]}},
    ):
        put(folder, {**content(folder), "color_camera": color, **extrinsics})
        frame = load_frame(folder)
        assert frame.labels is not None
        seen = ~np.isnan(frame.depth)
        assert seen.mean() > 0.99 * (~np.isnan(tabletop_frame.depth)).mean()
        assert (frame.labels == tabletop_frame.labels)[seen].mean() > 0.995


def test_labels_move_with_the_baseline(tabletop_frame: Frame, tmp_path: Path) -> None:
    """A colour camera 3 cm beside: what it sees of the scene, found again by the depth camera."""
    from conftest import make_tabletop

    T_color_depth = np.eye(4)
    T_color_depth[0, 3] = 0.03
    aside = -0.03 * tabletop_frame.camera.T_world_camera[:3, 0]
    color = make_tabletop(
        eye=tuple(np.add((-0.55, 0.0, 0.50), aside)), target=tuple(np.add((0.02, 0.0, 0.04), aside))
    )
    folder = base(tabletop_frame, tmp_path / "frame")
    Image.fromarray(color.frame.labels).save(folder / "labels.png")
    K = color.frame.camera.K
    put(
        folder,
        {
            **content(folder),
            "color_camera": {
                "K": K.tolist(),
                "width": color.frame.camera.width,
                "height": color.frame.camera.height,
            },
            "T_color_depth": T_color_depth.tolist(),
        },
    )
    frame = load_frame(folder)
    seen = ~np.isnan(frame.depth)
    assert seen.mean() > 0.93 * (~np.isnan(tabletop_frame.depth)).mean()
    assert (frame.labels == tabletop_frame.labels)[seen].mean() > 0.99


@pytest.mark.parametrize(
    ("model", "coefficients"),
    [("plumb_bob", [-0.2, 0.05, 0.001, -0.001, 0.0]), ("equidistant", [0.05, -0.01, 0.002, 0.0])],
)
def test_distorted_images_are_undistorted(
    tabletop_frame: Frame, tmp_path: Path, model: str, coefficients: list[float]
) -> None:
    import cv2

    K, d = tabletop_frame.camera.K, np.array(coefficients)
    height, width = tabletop_frame.depth.shape
    grid = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1).reshape(-1, 1, 2).astype(np.float64)
    undo = cv2.fisheye.undistortPoints if model == "equidistant" else cv2.undistortPoints
    source = undo(grid, K, d, P=K).reshape(height, width, 2).astype(np.float32)

    def distorted(image: np.ndarray) -> np.ndarray:
        return cv2.remap(image.astype(np.float32), source[..., 0], source[..., 1], cv2.INTER_NEAREST).astype(
            image.dtype
        )

    folder = base(tabletop_frame, tmp_path / "frame")
    (folder / "depth.png").unlink()
    np.save(folder / "depth.npy", distorted(np.nan_to_num(tabletop_frame.depth)))
    Image.fromarray(distorted(tabletop_frame.labels)).save(folder / "labels.png")
    put(folder, {**content(folder), "distortion_model": model, "distortion": coefficients})
    frame = load_frame(folder)
    assert any("undistorted" in note for note in frame.notes)
    both = ~np.isnan(frame.depth) & ~np.isnan(tabletop_frame.depth)
    assert both.mean() > 0.8
    assert np.median(np.abs(frame.depth - tabletop_frame.depth)[both]) < 0.003
    assert (frame.labels == tabletop_frame.labels)[both].mean() > 0.985
