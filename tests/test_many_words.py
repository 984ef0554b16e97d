"""Same scene, other words: one scene in sixty forms gives one frame."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from many_words import (
    Way,
    base,
    bop_keys,
    cloud,
    depth_array,
    depth_file,
    flat,
    keys,
    npz,
    open3d,
    pose,
    ray_length,
    realsense,
    ros_topic,
    ros_yaml,
    scaled,
    sentinel,
    text_K,
)
from many_words_labels import labels_as

from perception import Frame, load_frame
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
