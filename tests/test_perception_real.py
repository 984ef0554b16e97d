"""Cleaning on real sensor frames with predicted masks, against derived poses of scanned meshes."""

import json
from pathlib import Path

import numpy as np
import pytest

from perception import load_images, observe
from perception.camera import invert_rigid, transform

FRAMES = Path("../shared/data/real_rgbd/posecnn_pytorch_demo")
YCB = Path("../shared/data/ycb")

pytestmark = pytest.mark.skipif(
    not (FRAMES.is_dir() and YCB.is_dir()),
    reason="no real frames (../shared/data/real_rgbd, ../shared/data/ycb)",
)


@pytest.mark.parametrize("name", ["000000", "000002"])
def test_bled_masks_of_real_frames_are_cleaned(name: str) -> None:
    import open3d as o3d
    import trimesh

    poses = json.loads((FRAMES / "poses_google16k_derived.json").read_text())
    frame = load_images(
        FRAMES / f"{name}-color.png",
        FRAMES / f"{name}-depth.png",
        FRAMES / f"{name}-label_pred.png",
        np.array(poses["K"]),
        0.001,
    )
    result = observe(frame)
    assert result.support is not None
    assert result.support.inlier_ratio > 0.8
    assert len(result.objects) == 5
    raw = frame.camera.back_project(frame.depth).reshape(-1, 3)
    checked = 0
    for entry in poses["frames"][name]:
        path = YCB / entry["object"] / "google_16k" / "textured.obj"
        if entry["quality"] != "good" or not path.exists():
            continue
        mesh = trimesh.load(path, force="mesh", process=False).apply_transform(entry["T_cam_obj"])
        scene = o3d.t.geometry.RaycastingScene()
        scene.add_triangles(mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32))
        item = next(found for found in result.objects if found.label == entry["label"])
        kept = transform(invert_rigid(result.T_table_camera), item.points)
        distance = scene.compute_distance(kept).numpy()
        labelled = (frame.labels.reshape(-1) == entry["label"]) & np.isfinite(raw[:, 2])
        before = scene.compute_distance(np.ascontiguousarray(raw[labelled])).numpy()
        assert before.max() > 0.1  # the mask bleeds
        assert distance.max() < 0.02
        assert (distance < 0.01).mean() > 0.98
        assert (distance < 0.01).sum() > 0.99 * (before < 0.01).sum()  # next to no good point is lost
        checked += 1
    assert checked >= 2
