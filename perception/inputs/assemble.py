"""One Frame from what was found: stored depth, a camera file, colour and labels. The order of the steps is
here.

Metres first, then z instead of the ray's length, then lenses without distortion, then one camera for all
images.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from mapping.errors import FrameError
from perception.camera import Camera
from perception.frame import Frame
from perception.image_io import read_rgb
from perception.inputs.camera_keys import CameraFile
from perception.inputs.depth_files import StoredDepth, to_metres
from perception.inputs.distortion import undistort
from perception.inputs.label_files import read_labels
from perception.inputs.label_forms import Labels
from perception.inputs.registration import to_depth_camera


@dataclass(frozen=True)
class Parts:
    """What a frame is made of. rgb, labels: a file (or folder of masks), an array, or None.

    camera_name: where the camera came from; scale_name: where the scale is set; scale_floats: whether the
    scale is for float depth too. names: label -> name, from names.json. notes: what was noted already.
    """

    depth: StoredDepth
    camera: CameraFile
    camera_name: str
    source: str
    rgb: Path | np.ndarray | None = None
    labels: Path | Labels | None = None
    names: Mapping[int, str] = field(default_factory=dict)
    scale_name: str = "camera.json"
    scale_floats: bool = False
    notes: tuple[str, ...] = ()


def assemble(parts: Parts) -> Frame:
    """The frame of these parts. Raises FrameError that names the file at fault and how to mend it."""
    file = parts.camera
    metres, found = to_metres(parts.depth, file.depth_scale, parts.scale_name, parts.scale_floats)
    notes = [*parts.notes, *file.notes, *found]
    file = _of_this_size(file, metres, parts, notes)
    camera = _camera(file, metres.shape, parts.camera_name)
    if file.depth_kind == "ray":
        metres = metres / np.linalg.norm(camera.rays, axis=2)
        notes.append("depth was given as the length of the ray and turned into z")
    shape = (
        metres.shape
        if file.color is None or file.color.height is None
        else (file.color.height, file.color.width or 0)
    )
    rgb = read_rgb(parts.rgb) if isinstance(parts.rgb, Path) else parts.rgb
    labels = _labels(parts, shape)
    image = None if labels is None else labels.image
    apart = file.T_color_depth is not None and (rgb is not None or image is not None)
    if not apart:
        for picture, path in ((rgb, parts.rgb), (image, parts.labels)):
            if picture is not None:
                check_size(
                    picture, path if isinstance(path, Path) else parts.source, metres.shape, parts, file
                )
    if file.distortion is not None:
        metres, (rgb2, image2) = undistort(
            file.distortion, camera.K, metres, *((None, None) if apart else (rgb, image))
        )
        rgb, image = (rgb, image) if apart else (rgb2, image2)
        notes.append(
            f"{parts.camera_name}: images were undistorted ({file.distortion.model}, "
            f"{file.distortion.coefficients.size} coefficients)"
        )
    if apart:
        metres, rgb, image = _one_camera(file, camera, metres, rgb, image, parts)
        notes.append("colour and labels were brought to the depth camera by their extrinsics")
    names = dict(parts.names) if labels is None else {**labels.names, **parts.names}
    if labels is None and names:
        notes.append("names.json goes with the numbers of labels; there are none, so its names are not used")
        names = {}
    if labels is not None:
        notes += labels.notes
    return Frame(metres, camera, rgb, image, names, parts.source, tuple(notes), file.trust)


def check_size(
    image: np.ndarray, path: object, expected: tuple[int, ...], parts: Parts, file: CameraFile
) -> None:
    """Raise FrameError when an image has another size than depth."""
    if image.shape[:2] != tuple(expected):
        mend = "register all images to one camera and size"
        if file.color is not None:
            mend = "give T_color_depth (4x4, metres) beside the color camera, or register all images"
        elif isinstance(path, Path):
            mend += ", or give color_camera and T_color_depth in the camera file"
        raise FrameError(
            f"{path}: is {image.shape[1]}x{image.shape[0]} but {parts.depth.path.name} says "
            f"{expected[1]}x{expected[0]}; "
            f"{mend}"
        )


def _of_this_size(file: CameraFile, metres: np.ndarray, parts: Parts, notes: list[str]) -> CameraFile:
    """The camera that the depth image was registered to: its own, or colour's where only that has its
    size."""
    size = (metres.shape[1], metres.shape[0])
    own = (file.width or size[0], file.height or size[1])
    if size == own:
        return file
    if file.color is not None and size == (file.color.width, file.color.height):
        notes.append(f"{parts.depth.path.name} has the size of the color camera: taken as aligned to it")
        pose = file.T_world_camera
        return replace(file.color, depth_scale=file.depth_scale, T_world_camera=pose, trust=file.trust)
    raise FrameError(
        f"{parts.depth.path}: is {size[0]}x{size[1]} but {Path(parts.camera_name).name} says "
        f"{own[0]}x{own[1]}; "
        "register all images to one camera and size, or give the camera of this stream"
    )


def _camera(file: CameraFile, shape: tuple[int, ...], name: str) -> Camera:
    K = file.K
    if np.abs(K[2, :2]).max() > 1e-6 and np.abs(K[:2, 2]).max() < 1e-6:
        raise FrameError(
            f"{name}: K is transposed: cx and cy stand in its last row; write it by rows, fx 0 cx / 0 fy "
            f"cy / 0 0 1"
        )
    if np.shape(K) == (3, 3) and np.abs(K[2] - [0, 0, 1]).max() > 1e-6:
        raise FrameError(f"{name}: K: its last row must be 0 0 1, got {', '.join(f'{v:g}' for v in K[2])}")
    try:
        pose = np.eye(4) if file.T_world_camera is None else file.T_world_camera
        return Camera(K, shape[1], shape[0], pose)
    except FrameError as error:
        raise FrameError(f"{name}: {error}") from error


def _labels(parts: Parts, shape: tuple[int, ...]) -> Labels | None:
    if not isinstance(parts.labels, Path):
        return parts.labels
    image_name = parts.rgb.name if isinstance(parts.rgb, Path) else None
    return read_labels(parts.labels, (shape[0], shape[1]), tuple(parts.names), image_name)


def _one_camera(
    file: CameraFile,
    camera: Camera,
    metres: np.ndarray,
    rgb: np.ndarray | None,
    image: np.ndarray | None,
    parts: Parts,
) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
    color, T = file.color, file.T_color_depth
    if color is None or T is None:
        raise FrameError(f"{parts.camera_name}: has T_color_depth but no color_camera (K, width, height)")
    picture = rgb if rgb is not None else image
    assert picture is not None
    height, width = picture.shape[:2]
    if (color.width or width, color.height or height) != (width, height):
        raise FrameError(
            f"{parts.source}: colour or labels are {width}x{height} but color_camera says "
            f"{color.width}x{color.height}"
        )
    if rgb is not None and image is not None and image.shape != rgb.shape[:2]:
        raise FrameError(
            f"{parts.source}: labels are {image.shape[1]}x{image.shape[0]} but colour {width}x{height}"
        )
    color_camera = _camera(color, (height, width), f"{parts.camera_name}: color_camera")
    try:
        Camera(color_camera.K, width, height, T)
    except FrameError as error:
        raise FrameError(f"{parts.camera_name}: T_color_depth is not a rigid transform [m]") from error
    if np.linalg.norm(T[:3, 3]) > LONGEST_BASELINE:
        raise FrameError(
            f"{parts.camera_name}: T_color_depth sets the two cameras {np.linalg.norm(T[:3, 3]):.3g} m "
            f"apart; it must be "
            "in metres"
        )
    metres, (rgb, image) = to_depth_camera(metres, camera, color_camera, T, color.distortion, rgb, image)
    return metres, rgb, image


LONGEST_BASELINE = 1.0
"""Depth and colour cameras of one device are not farther apart than this [m]."""
