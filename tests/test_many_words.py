"""Same scene, other words: one scene in sixty forms gives one frame; forty wrong ones give one line each."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from many_words import (
    OPENGL,
    Way,
    base,
    bop_keys,
    cloud,
    content,
    depth_array,
    depth_file,
    flat,
    keys,
    labels_as,
    npz,
    open3d,
    pose,
    put,
    ray_length,
    realsense,
    ros_topic,
    ros_yaml,
    scaled,
    sentinel,
    text_K,
)
from PIL import Image

from mapping import FrameError
from perception import Camera, Frame, load_frame, observe
from perception.camera import invert_rigid
from reconstruction import reconstruct
from reconstruction.solid import Solid

WAYS = [
    Way("frame folder", base),
    Way("0.1 mm", scaled(1e-4), 0.00006),
    Way("0.25 mm", scaled(2.5e-4), 0.00016),
    Way("10 m over 16 bits", scaled(10 / 65535), 0.0001),
    Way("2 mm", scaled(2e-3), 0.0011),
    Way("float32 metres", depth_array(np.float32, None), 1e-6),
    Way("float64 metres", depth_array(np.float64, None), 1e-6),
    Way("float16 metres", depth_array(np.float16, None), 0.001),
    Way("float millimetres and their scale", depth_array(np.float32, 0.001), 1e-6),
    Way("uint16 array", depth_array(np.uint16, 0.001)),
    Way("int32 array", depth_array(np.int32, 0.001)),
    Way("depth with an axis too many", depth_array(np.float32, None, (0, 1, 2)), 1e-6),
    Way("float TIFF", depth_file(".tiff"), 1e-6),
    Way("16-bit TIFF", depth_file("16.tiff")),
    Way("EXR", depth_file(".exr"), 1e-6),
    Way("65535 for missing", sentinel(65535)),
    Way("20 m for missing", sentinel(20000)),
    Way("ray length, said so", ray_length, 1e-6),
    Way("flat K", keys(flat)),
    Way("K in nine numbers", keys(lambda c, f: {**c, "K": np.array(c["K"]).reshape(-1).tolist()})),
    Way(
        "factor_depth",
        keys(lambda c, f: {**{k: v for k, v in c.items() if k != "depth_scale"}, "factor_depth": 1000}),
    ),
    Way("unit in a word", keys(lambda c, f: {**c, "depth_scale": "mm"})),
    Way("intrinsics.json", keys(lambda c, f: c, "intrinsics.json")),
    Way("ROS calibration file", ros_yaml),
    Way("ROS topic", ros_topic),
    Way("RealSense", keys(realsense)),
    Way("Open3D", keys(open3d)),
    Way("BOP keys", keys(bop_keys)),
    Way("K as text", text_K, 1e-6),
    Way("pose in seven numbers", keys(pose("seven"))),
    Way("ROS pose", keys(pose("ros"))),
    Way("pose with wxyz", keys(pose("wxyz"))),
    Way("pose in twelve numbers", keys(pose("rows"))),
    Way("world to camera", keys(pose("inverse"))),
    Way("OpenGL axes, said so", keys(pose("opengl"))),
    Way("world to OpenGL camera", keys(pose("w2c opengl"))),
    *(
        Way(f"labels: {form}", labels_as(form))
        for form in (
            "int64",
            "float",
            "-1",
            "255",
            "65535",
            "stack",
            "stack last",
            "torch",
            "npz",
            "palette",
            "grey rgb",
            "masks",
            "mask_visib",
            "coco",
            "coco string",
            "coco list",
        )
    ),
    Way("npz", npz(), 1e-6),
    Way(
        "npz with units",
        npz(
            depth=lambda f: np.rint(np.nan_to_num(f.depth) * 1e4).astype(np.uint16),
            depth_scale=lambda f: 1e-4,
        ),
        0.00006,
    ),
    Way(
        "npz with masks",
        npz(segmap=lambda f: None, masks=lambda f: np.stack([f.labels == k for k in range(1, 5)])),
        1e-6,
    ),
    Way("npz with flat K", npz(K=lambda f: f.camera.K.reshape(-1)), 1e-6),
    Way("PCD", cloud(".pcd", world=False), 2e-6, colour=False),
    Way("PCD in the world", cloud(".pcd", world=True), 1e-4, colour=False),
    Way("PLY", cloud(".ply", world=False), 2e-6, same_pose=False, colour=False),
    Way("PLY in the world", cloud(".ply", world=True), 1e-4, colour=False),
]


def check_same(frame: Frame, true: Frame, way: Way) -> None:
    """The same depth to the step of the form, the same labels, names' numbers, camera and pose."""
    np.testing.assert_array_equal(np.isnan(frame.depth), np.isnan(true.depth))
    np.testing.assert_allclose(frame.depth, true.depth, atol=way.depth_step)
    np.testing.assert_array_equal(frame.labels, true.labels)
    np.testing.assert_allclose(frame.camera.K, true.camera.K, atol=0.02)
    if way.same_pose:
        np.testing.assert_allclose(frame.camera.T_world_camera, true.camera.T_world_camera, atol=2e-4)


@pytest.mark.parametrize("way", WAYS, ids=lambda way: way.name)
def test_every_form_is_the_same_frame(tabletop_frame: Frame, tmp_path: Path, way: Way) -> None:
    depth = tabletop_frame.depth.copy()
    depth[:12, :12] = np.nan  # something is missing in every depth image
    true = replace(tabletop_frame, depth=depth)
    frame = load_frame(way.write(true, tmp_path / "frame"))
    check_same(frame, true, way)
    if way.colour and frame.rgb is not None:
        np.testing.assert_array_equal(frame.rgb, true.rgb)
    assert not any("not understood" in note for note in frame.notes)


@pytest.fixture(scope="module")
def whole(tabletop_frame: Frame) -> Frame:
    """The frame in whole millimetres, so that no form rounds it further."""
    return replace(tabletop_frame, depth=np.rint(1000 * tabletop_frame.depth) / np.float32(1000))


@pytest.fixture(scope="module")
def meshes(whole: Frame) -> dict[int, Any]:
    """The objects' meshes, from the frame itself."""
    return {item.label: item.mesh for item in reconstruct(whole).objects}


@pytest.mark.parametrize(
    "name",
    [
        "PCD in the world",
        *(
            pytest.param(n, marks=pytest.mark.slow)
            for n in ("0.1 mm", "EXR", "BOP keys", "labels: coco string", "labels: mask_visib")
        ),
    ],
)
def test_meshes_are_the_same_to_a_millimetre(
    whole: Frame, meshes: dict[int, Any], tmp_path: Path, name: str
) -> None:
    way = next(item for item in WAYS if item.name == name)
    result = reconstruct(load_frame(way.write(whole, tmp_path / "frame")))
    assert {item.label for item in result.objects} == set(meshes)
    for item in result.objects:
        distance = Solid(meshes[item.label]).distance(item.mesh.vertices.astype(np.float32))
        assert np.quantile(np.abs(distance), 0.95) < 0.001


def test_arrays_in_memory_are_the_same_frame(tabletop_frame: Frame) -> None:
    true, camera = tabletop_frame, tabletop_frame.camera
    assert true.labels is not None
    masks = [true.labels == label for label in (1, 2, 3, 4)]
    fx, fy, cx, cy = camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]
    units = np.rint(np.nan_to_num(true.depth) * 1e4).astype(np.uint16)
    T = camera.T_world_camera
    for depth, K, given, scale in (
        (true.depth, camera.K, true.labels, None),
        (true.depth, (fx, fy, cx, cy), np.stack(masks), None),
        (units, camera.K.reshape(-1), masks, 1e-4),
        (1000 * true.depth, camera.K, dict(enumerate(masks, start=1)), 0.001),
        (true.depth[..., None], camera.K, {"a": masks[0], "b": masks[1], "c": masks[2], "d": masks[3]}, None),
    ):
        frame = Frame.from_arrays(depth, K, given, T, depth_scale=scale)
        check_same(frame, true, Way("arrays", base, 0.0001))
    assert frame.names == {1: "a", 2: "b", 3: "c", 4: "d"}
    assert Frame.from_arrays(true.depth, camera.K).labels is None


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
