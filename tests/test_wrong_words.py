"""Forty wrong forms of a frame give one line each; what is vouched for is taken."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from many_words import (
    OPENGL,
    base,
    cloud,
    content,
    npz,
    put,
)

from mapping import FrameError
from perception import Frame, load_frame, observe
from perception.camera import invert_rigid


def camera_key(**changes: Any):
    """camera.json with keys changed; None takes one away."""

    def spoil(frame: Frame, folder: Path) -> Path:
        base(frame, folder)
        camera = {key: value for key, value in {**content(folder), **changes}.items() if value is not None}
        put(folder, camera)
        return folder

    return spoil


def other_K(change) -> Any:
    def spoil(frame: Frame, folder: Path) -> Path:
        base(frame, folder)
        put(folder, {**content(folder), "K": change(frame.camera.K.copy(), frame).tolist()})
        return folder

    return spoil


def other_depth(change) -> Any:
    def spoil(frame: Frame, folder: Path) -> Path:
        base(frame, folder)
        (folder / "depth.png").unlink()
        np.save(folder / "depth.npy", change(frame).astype(np.float32))
        return folder

    return spoil


def other_pose(change) -> Any:
    def spoil(frame: Frame, folder: Path) -> Path:
        base(frame, folder)
        put(
            folder, {**content(folder), "T_world_camera": change(frame.camera.T_world_camera.copy()).tolist()}
        )
        return folder

    return spoil


def file_of(name: str, body: str, drop: str | None = None) -> Any:
    def spoil(frame: Frame, folder: Path) -> Path:
        base(frame, folder)
        if drop is not None:
            (folder / drop).unlink()
        (folder / name).write_text(body)
        return folder

    return spoil


def millimetres(T: np.ndarray) -> np.ndarray:
    T[:3, 3] *= 1000
    return T


def scaled_K(factor: float) -> Any:
    def change(K: np.ndarray, frame: Frame) -> np.ndarray:
        K[:2] *= factor
        return K

    return other_K(change)


def row_of(K: np.ndarray, frame: Frame) -> np.ndarray:
    K[0] /= frame.camera.width
    K[1] /= frame.camera.height
    return K


def swapped(K: np.ndarray, frame: Frame) -> np.ndarray:
    K[0, 2], K[1, 2] = K[1, 2], K[0, 2]
    return K


def from_ppy(K: np.ndarray, frame: Frame) -> np.ndarray:
    K[0, 0] = K[1, 2]
    return K


def organised_wrong(frame: Frame, folder: Path) -> Path:
    path = cloud(".pcd", world=False)(frame, folder)
    raw = path.read_bytes()
    width, height = frame.camera.width, frame.camera.height
    path.write_bytes(
        raw.replace(f"WIDTH {width}\nHEIGHT {height}".encode(), f"WIDTH {width * height}\nHEIGHT 1".encode())
    )
    return path


def reordered(frame: Frame, folder: Path) -> Path:
    path = cloud(".pcd", world=False)(frame, folder)
    raw = path.read_bytes()
    width, height = frame.camera.width, frame.camera.height
    path.write_bytes(
        raw.replace(f"WIDTH {width}\nHEIGHT {height}".encode(), f"WIDTH {height}\nHEIGHT {width}".encode())
    )
    return path


def fractions(frame: Frame, folder: Path) -> Path:
    base(frame, folder)
    (folder / "labels.png").unlink()
    np.save(folder / "labels.npy", frame.labels * 0.5)
    return folder


def rays(frame: Frame) -> np.ndarray:
    return frame.depth * np.linalg.norm(frame.camera.rays, axis=2)


WRONG: list[tuple[str, Any, str]] = [
    ("unit / 10", other_depth(lambda f: f.depth / 10), "depth_scale times 10 "),
    ("unit / 4", other_depth(lambda f: f.depth / 4), "depth_scale times 4 "),
    ("unit / 2.5", other_depth(lambda f: f.depth / 2.5), "depth_scale times 2.5 "),
    ("unit x 2.5", other_depth(lambda f: f.depth * 2.5), "depth_scale times 0.4 "),
    ("unit x 4", other_depth(lambda f: f.depth * 4), "depth_scale times 0.25 "),
    ("unit x 6.5", other_depth(lambda f: f.depth * 6.5535), "depth_scale times 0.1526 "),
    ("unit x 10", other_depth(lambda f: f.depth * 10), "depth_scale times 0.1 "),
    ("unit x 1000", camera_key(depth_scale=1.0), "0.001 for millimetres"),
    ("unit / 1000", camera_key(depth_scale=1e-6), "depth_scale"),
    ("no scale", camera_key(depth_scale=None), "lacks depth_scale"),
    ("scale in a strange word", camera_key(depth_scale="furlong"), "depth_scale"),
    ("ray length", other_depth(rays), 'set "depth_kind": "ray"'),
    ("disparity", other_depth(lambda f: 0.6 / f.depth), "disparity"),
    ("z-buffer", other_depth(lambda f: (10 - 1 / f.depth) / 9.9), "z-buffer"),
    (
        "z-buffer with its 1s",
        other_depth(lambda f: np.where(f.depth > 0.7, 1, (100 - 1 / f.depth) / 99.9)),
        "z-buffer",
    ),
    ("kind unknown", camera_key(depth_kind="log"), "depth_kind must be"),
    ("K of half the size", scaled_K(0.5), "K belongs to a 160x120 image"),
    ("K of twice the size", scaled_K(2.0), "K"),
    ("K of four times the size", scaled_K(4.0), "K belongs to a 1277x957 image"),
    ("K of 3.3 times the size", scaled_K(3.3), "K belongs to a 1054x790 image"),
    (
        "K of another shape, its principal point outside",
        other_K(lambda K, f: np.array([[900, 0, 500.0], [0, 900, 180.0], [0, 0, 1]])),
        "the table tilts",
    ),
    (
        "K of another shape",
        other_K(lambda K, f: np.array([[600, 0, 319.5], [0, 600, 179.5], [0, 0, 1.0]])),
        "640x360",
    ),
    ("K transposed", other_K(lambda K, f: K.T), "transposed"),
    ("K in fractions", other_K(row_of), "fractions of the image"),
    ("cx and cy exchanged", other_K(swapped), "exchange"),
    ("fx from ppy", other_K(from_ppy), "fx="),
    ("K with a wrong row", other_K(lambda K, f: K + np.diag([0, 0, 1.0])), "last row"),
    (
        "unknown lens",
        camera_key(distortion=[0.1] * 5, distortion_model="ftheta"),
        "distortion model 'ftheta'",
    ),
    ("three coefficients", camera_key(distortion=[0.1, 0.2, 0.3]), "3 coefficients"),
    ("pose in millimetres", other_pose(millimetres), "divide its translation by 1000"),
    ("pose in OpenGL axes", other_pose(lambda T: T @ OPENGL), '"axes": "opengl"'),
    ("pose inverted", other_pose(invert_rigid), "its inverse"),
    ("pose inverted, OpenGL", other_pose(lambda T: invert_rigid(T @ OPENGL)), "T_camera_world"),
    ("pose transposed", other_pose(lambda T: T.T), "transposed"),
    (
        "pose without a direction",
        camera_key(T_world_camera=None, extrinsics=np.eye(4).tolist()),
        "T_camera_world",
    ),
    ("quaternion not of length 1", camera_key(T_world_camera=[0, 0, 1, 1, 1, 0, 1]), "quaternion"),
    ("axes unknown", camera_key(axes="unity"), "axes must be"),
    ("trust in nothing", camera_key(trust=["all"]), "trust can hold"),
    ("cloud without rows", organised_wrong, "not organised"),
    ("cloud of other rows", reordered, "no pinhole camera"),
    ("labels in fractions", fractions, "whole numbers"),
    (
        "COCO without masks",
        file_of("annotations.json", json.dumps([{"id": 1}]), "labels.png"),
        "lacks segmentation",
    ),
    (
        "COCO of another size",
        file_of(
            "annotations.json",
            json.dumps([{"id": 1, "segmentation": {"size": [2, 2], "counts": [0, 4]}}]),
            "labels.png",
        ),
        "2x2",
    ),
    ("YAML that is none", file_of("camera.yaml", "K: [1, 2", "camera.json"), "YAML"),
    ("names for no number", file_of("names.json", '{"mug": "1"}'), "label numbers"),
]


@pytest.mark.parametrize(
    ("spoil", "message"), [(s, m) for _, s, m in WRONG], ids=[name for name, _, _ in WRONG]
)
def test_every_wrong_form_is_answered_in_one_line(
    tabletop_frame: Frame, tmp_path: Path, spoil: Any, message: str
) -> None:
    with pytest.raises(FrameError) as caught:
        observe(load_frame(spoil(tabletop_frame, tmp_path / "frame")))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_is_vouched_for_is_not_refused(tabletop_frame: Frame, tmp_path: Path) -> None:
    large = other_depth(lambda f: f.depth * 4)(tabletop_frame, tmp_path / "large")
    put(large, {**content(large), "trust": ["unit"]})
    assert len(observe(load_frame(large)).objects) == 4
    cut = scaled_K(2.0)(tabletop_frame, tmp_path / "cut")
    assert load_frame(cut, trust=["K"]).camera.K[0, 2] > 300


def test_keys_not_understood_are_named(tabletop_frame: Frame, tmp_path: Path) -> None:
    folder = camera_key(gamma=2.2, lens="wide")(tabletop_frame, tmp_path / "frame")
    (note,) = load_frame(folder).notes
    assert "gamma" in note
    assert "lens" in note
    (note,) = load_frame(npz(mystery=lambda f: np.zeros(3))(tabletop_frame, tmp_path / "npz")).notes
    assert "mystery" in note
