"""One scene in many words: writers of frames in the forms people have them, right ones and wrong ones."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from perception import Frame, save_frame
from perception.camera import invert_rigid

OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True)
class Way:
    """How one scene is written. write(frame, folder): what load_frame takes; depth_step: its step [m]."""

    name: str
    write: Callable[[Frame, Path], Path]
    depth_step: float = 0.0006
    same_pose: bool = True
    colour: bool = True


def base(frame: Frame, folder: Path) -> Path:
    """A plain frame folder."""
    save_frame(frame, folder)
    return folder


def content(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "camera.json").read_text())


def put(folder: Path, camera: dict[str, Any], name: str = "camera.json") -> None:
    (folder / "camera.json").unlink(missing_ok=True)
    (folder / name).write_text(json.dumps(camera))


def numbers(frame: Frame) -> tuple[float, float, float, float]:
    K = frame.camera.K
    return float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])


def scaled(unit: float) -> Callable[[Frame, Path], Path]:
    def write(frame: Frame, folder: Path) -> Path:
        save_frame(frame, folder, unit)
        return folder

    return write


def depth_array(
    dtype: Any, scale: float | None, shape: tuple[int, ...] = (0, 1)
) -> Callable[[Frame, Path], Path]:
    """depth.npy of a type: metres, or units of `scale` [m]; missing as 0 or NaN; with more axes."""

    def write(frame: Frame, folder: Path) -> Path:
        base(frame, folder)
        (folder / "depth.png").unlink()
        depth = np.nan_to_num(frame.depth).astype(np.float64) / (scale or 1)
        depth = np.rint(depth) if np.issubdtype(dtype, np.integer) else depth
        stored = depth.astype(dtype)
        np.save(folder / "depth.npy", stored[..., None] if shape == (0, 1, 2) else stored)
        put(folder, {**content(folder), "depth_scale": scale or 1.0})
        return folder

    return write


def depth_file(suffix: str) -> Callable[[Frame, Path], Path]:
    def write(frame: Frame, folder: Path) -> Path:
        base(frame, folder)
        (folder / "depth.png").unlink()
        depth = np.nan_to_num(frame.depth)
        if suffix == ".exr":
            import OpenEXR

            with OpenEXR.File({"type": OpenEXR.scanlineimage}, {"Z": depth}) as file:
                file.write(str(folder / "depth.exr"))
        elif suffix == "16.tiff":
            Image.fromarray(np.rint(1000 * depth).astype(np.uint16)).save(folder / "depth.tiff")
        else:
            Image.fromarray(depth).save(folder / f"depth{suffix}")
        return folder

    return write


def sentinel(value: int) -> Callable[[Frame, Path], Path]:
    def write(frame: Frame, folder: Path) -> Path:
        base(frame, folder)
        depth = np.array(Image.open(folder / "depth.png"))
        depth[depth == 0] = value
        Image.fromarray(depth).save(folder / "depth.png")
        return folder

    return write


def keys(
    change: Callable[[dict[str, Any], Frame], dict[str, Any]], name: str = "camera.json"
) -> Callable[[Frame, Path], Path]:
    """The camera file, changed."""

    def write(frame: Frame, folder: Path) -> Path:
        base(frame, folder)
        put(folder, change(content(folder), frame), name)
        return folder

    return write


def flat(camera: dict[str, Any], frame: Frame) -> dict[str, Any]:
    fx, fy, cx, cy = numbers(frame)
    del camera["K"]
    return {**camera, "fx": fx, "fy": fy, "cx": cx, "cy": cy}


def realsense(camera: dict[str, Any], frame: Frame) -> dict[str, Any]:
    fx, fy, cx, cy = numbers(frame)
    T = camera["T_world_camera"]
    size = {"width": camera["width"], "height": camera["height"]}
    inner = {
        **size,
        "fx": fx,
        "fy": fy,
        "ppx": cx,
        "ppy": cy,
        "model": "distortion.brown_conrady",
        "coeffs": [0.0] * 5,
    }
    return {"depth": inner, "depth_scale": camera["depth_scale"], "T_world_camera": T}


def open3d(camera: dict[str, Any], frame: Frame) -> dict[str, Any]:
    inverse = invert_rigid(frame.camera.T_world_camera)
    return {
        "class_name": "PinholeCameraParameters",
        "extrinsic": inverse.T.reshape(-1).tolist(),
        "intrinsic": {
            "width": camera["width"],
            "height": camera["height"],
            "intrinsic_matrix": np.array(camera["K"]).T.reshape(-1).tolist(),
        },
        "depth_scale": camera["depth_scale"],
        "version_major": 1,
        "version_minor": 0,
    }


def bop_keys(camera: dict[str, Any], frame: Frame) -> dict[str, Any]:
    inverse = invert_rigid(frame.camera.T_world_camera)
    return {
        "cam_K": np.array(camera["K"]).reshape(-1).tolist(),
        "depth_scale": 1000 * camera["depth_scale"],
        "cam_R_w2c": inverse[:3, :3].reshape(-1).tolist(),
        "cam_t_w2c": (1000 * inverse[:3, 3]).tolist(),
        "view_level": 0,
    }


def quaternion(T: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(T[:3, :3]).as_quat()


def pose(form: str) -> Callable[[dict[str, Any], Frame], dict[str, Any]]:
    """T_world_camera in another form."""

    def change(camera: dict[str, Any], frame: Frame) -> dict[str, Any]:
        T = frame.camera.T_world_camera
        q, t = quaternion(T).tolist(), T[:3, 3].tolist()
        del camera["T_world_camera"]
        forms: dict[str, dict[str, Any]] = {
            "seven": {"pose": [*t, *q]},
            "ros": {"pose": {"position": dict(zip("xyz", t)), "orientation": dict(zip("xyzw", q))}},
            "wxyz": {"pose": {"translation": t, "quaternion_wxyz": [q[3], *q[:3]]}},
            "rows": {"cam2world": T[:3].reshape(-1).tolist()},
            "inverse": {"T_camera_world": invert_rigid(T).tolist()},
            "opengl": {"T_world_camera": (T @ OPENGL).tolist(), "axes": "opengl"},
            "w2c opengl": {"w2c": invert_rigid(T @ OPENGL).tolist(), "axes": "opengl"},
        }
        return {**camera, **forms[form]}

    return change


def ros_yaml(frame: Frame, folder: Path) -> Path:
    """camera_info.yaml as image_proc's calibrator writes it, the pose beside it."""
    base(frame, folder)
    camera = content(folder)
    (folder / "camera.json").unlink()
    K = ", ".join(str(value) for value in np.array(camera["K"]).reshape(-1))
    (folder / "camera_info.yaml").write_text(
        f"image_width: {camera['width']}\nimage_height: {camera['height']}\ncamera_name: depth\n"
        f"camera_matrix:\n  rows: 3\n  cols: 3\n  data: [{K}]\ndistortion_model: plumb_bob\n"
        "distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [0, 0, 0, 0, 0]\n"
        "rectification_matrix:\n  rows: 3\n  cols: 3\n  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]\ndepth_unit: mm\n"
    )
    np.savetxt(folder / "pose.txt", frame.camera.T_world_camera)
    return folder


def ros_topic(frame: Frame, folder: Path) -> Path:
    """What `ros2 topic echo` prints of a CameraInfo."""
    ros_yaml(frame, folder)
    K = np.array(frame.camera.K).reshape(-1).tolist()
    P = np.hstack([frame.camera.K, np.zeros((3, 1))]).reshape(-1).tolist()
    (folder / "camera_info.yaml").write_text(
        f"header:\n  frame_id: depth\nheight: {frame.camera.height}\nwidth: {frame.camera.width}\n"
        f"distortion_model: plumb_bob\nd: [0.0, 0.0, 0.0, 0.0, 0.0]\nk: {K}\nr: [1, 0, 0, 0, 1, 0, 0, 0, 1]\n"
        f"p: {P}\nbinning_x: 0\nbinning_y: 0\ndepth_scale: 0.001\n---\n"
    )
    return folder


def text_K(frame: Frame, folder: Path) -> Path:
    """intrinsics.txt with K alone: depth in metres, pose in a file of its own."""
    depth_file(".tiff")(frame, folder)
    (folder / "camera.json").unlink()
    np.savetxt(folder / "intrinsics.txt", frame.camera.K)
    np.save(folder / "T_world_camera.npy", frame.camera.T_world_camera)
    return folder


def npz(**changes: Any) -> Callable[[Frame, Path], Path]:
    def write(frame: Frame, folder: Path) -> Path:
        folder.mkdir(parents=True)
        arrays: dict[str, Any] = {
            "depth": frame.depth,
            "K": frame.camera.K,
            "T_world_camera": frame.camera.T_world_camera,
        }
        arrays |= {"segmap": frame.labels, "rgb": frame.rgb}
        arrays |= {key: change(frame) for key, change in changes.items()}
        np.savez(folder / "frame.npz", **{key: value for key, value in arrays.items() if value is not None})
        return folder / "frame.npz"

    return write


def cloud(suffix: str, world: bool) -> Callable[[Frame, Path], Path]:
    """An organised cloud with labels, in the camera's frame or the world's."""

    def write(frame: Frame, folder: Path) -> Path:
        import open3d as o3d

        assert frame.labels is not None
        folder.mkdir(parents=True)
        T = frame.camera.T_world_camera
        points = frame.camera.back_project(frame.depth).reshape(-1, 3).astype(np.float64)
        if world:
            points = points @ T[:3, :3].T + T[:3, 3]
        data = o3d.t.geometry.PointCloud(points.astype(np.float32))
        data.point["label"] = o3d.core.Tensor(frame.labels.reshape(-1, 1).astype(np.int32))
        path = folder / f"cloud{suffix}"
        o3d.t.io.write_point_cloud(str(path), data, write_ascii=False)
        raw = path.read_bytes()
        width, height = frame.camera.width, frame.camera.height
        if suffix == ".pcd":
            raw = raw.replace(
                f"WIDTH {width * height}\nHEIGHT 1\n".encode(), f"WIDTH {width}\nHEIGHT {height}\n".encode()
            )
            if not world:
                x, y, z = T[:3, 3]
                qx, qy, qz, qw = quaternion(T)
                view = f"VIEWPOINT {x} {y} {z} {qw} {qx} {qy} {qz}\n"
                raw = raw.replace(b"VIEWPOINT 0 0 0 1 0 0 0\n", view.encode())
        else:
            sides = f"obj_info num_cols {width}\nobj_info num_rows {height}\nelement vertex"
            raw = raw.replace(b"element vertex", sides.encode(), 1)
        path.write_bytes(raw)
        return path

    return write


def ray_length(frame: Frame, folder: Path) -> Path:
    """Depth as the length of the ray, and said so."""
    base(frame, folder)
    (folder / "depth.png").unlink()
    np.save(folder / "depth.npy", frame.depth * np.linalg.norm(frame.camera.rays, axis=2))
    put(folder, {**content(folder), "depth_kind": "ray"})
    return folder
