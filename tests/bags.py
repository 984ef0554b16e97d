"""ROS bags of frames, written with rosbags as recorders write them; for the tests of their reader."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from perception.camera import invert_rigid
from perception.frame import Frame

KINDS = ("ros1", "mcap", "sqlite3")
OPTICAL, HAND, WORLD = "camera_color_optical_frame", "hand", "map"
START = 1_700_000_000_250_000_000
"""Stamp of the first frame [ns]."""
T_HAND_CAMERA = np.eye(4)
T_HAND_CAMERA[:3, :3] = Rotation.from_euler("xyz", [10, -20, 35], degrees=True).as_matrix()
T_HAND_CAMERA[:3, 3] = (0.05, -0.02, 0.1)
DEPTH, COLOUR, INFO, LABELS = (
    "/camera/aligned_depth_to_color/image_raw",
    "/camera/color/image_raw",
    "/camera/color/camera_info",
    "/segmentation/labels",
)


def write_bag(
    path: Path,
    frames: Sequence[Frame],
    kind: str = "mcap",
    depth: str = "16UC1",
    label: str = "mono16",
    leave_out: Iterable[str] = (),
    further: Iterable[tuple[str, str, int, dict[str, Any]]] = (),
    step: int = 10**9,
) -> Path:
    """A bag of frames, one each `step` ns. leave_out: topics not written. further: more messages as
    (topic, type, stamp, fields). The camera hangs on a hand that tf places before and after each frame."""
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    first = kind == "ros1"
    store = get_typestore(Stores.ROS1_NOETIC if first else Stores.ROS2_HUMBLE)
    if first:
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TFM))
    out = path.with_suffix(".bag") if first else path
    if first:
        bag: Any = Writer1(out)
    else:
        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        bag = Writer2(out, version=9, storage_plugin=plugin)
    messages = []
    for number, frame in enumerate(frames):
        stamp = START + number * step
        messages += [m for m in _messages(frame, stamp, depth, label) if m[0] not in leave_out]
    if "/tf" not in leave_out:
        messages += [
            ("/tf_static", TFM, START, {"transforms": [_transform(T_HAND_CAMERA, HAND, OPTICAL, START)]})
        ]
    messages += list(further)
    with bag:
        connections: dict[str, Any] = {}
        for topic, name, stamp, fields in sorted(messages, key=lambda message: message[2]):
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, name, typestore=store)
            message = _message(store, name, fields, first)
            raw = store.serialize_ros1(message, name) if first else store.serialize_cdr(message, name)
            # Recorded a little later than measured.
            bag.write(connections[topic], stamp + 3_000_000, raw)
    return out


IMAGE, CAMERA_INFO, TFM = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo", "tf2_msgs/msg/TFMessage"


def image(array: np.ndarray, encoding: str, stamp: int, frame: str = OPTICAL) -> dict[str, Any]:
    """Fields of an Image."""
    return {
        "header": _header(stamp, frame),
        "height": array.shape[0],
        "width": array.shape[1],
        "encoding": encoding,
        "is_bigendian": 0,
        "step": array[0].nbytes,
        "data": np.ascontiguousarray(array).view(np.uint8).reshape(-1),
    }


def _messages(frame: Frame, stamp: int, depth: str, label: str) -> list[tuple[str, str, int, dict[str, Any]]]:
    millimetres = np.rint(np.nan_to_num(frame.depth) * 1000)
    stored = millimetres.astype(np.uint16) if depth == "16UC1" else (millimetres * 0.001).astype(np.float32)
    camera = frame.camera
    assert frame.rgb is not None
    assert frame.labels is not None
    info = {
        "header": _header(stamp, OPTICAL),
        "height": camera.height,
        "width": camera.width,
        "distortion_model": "plumb_bob",
        "d": np.zeros(5),
        "k": camera.K.reshape(-1),
        "r": np.eye(3).reshape(-1),
        "p": np.hstack([camera.K, np.zeros((3, 1))]).reshape(-1),
        "binning_x": 0,
        "binning_y": 0,
    }
    hand = camera.T_world_camera @ invert_rigid(T_HAND_CAMERA)
    numbers = frame.labels.astype(np.uint16 if label == "mono16" else np.int32)
    return [
        (DEPTH, IMAGE, stamp, image(stored, depth, stamp)),
        (COLOUR, IMAGE, stamp, image(frame.rgb[..., ::-1], "bgr8", stamp)),
        (INFO, CAMERA_INFO, stamp, info),
        (LABELS, IMAGE, stamp, image(numbers, label, stamp)),
        *(
            ("/tf", TFM, stamp + shift, {"transforms": [_transform(hand, WORLD, HAND, stamp + shift)]})
            for shift in (-20_000_000, 20_000_000)
        ),
    ]


def _header(stamp: int, frame: str) -> dict[str, Any]:
    return {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}, "frame_id": frame}


def _transform(T: np.ndarray, parent: str, child: str, stamp: int) -> dict[str, Any]:
    q = Rotation.from_matrix(T[:3, :3]).as_quat()
    return {
        "header": _header(stamp, parent),
        "child_frame_id": child,
        "transform": {"translation": dict(zip("xyz", T[:3, 3])), "rotation": dict(zip("xyzw", q))},
    }


def _message(store: Any, name: str, fields: dict[str, Any], first: bool) -> Any:
    """rosbags' object of a message; ROS 1 has a number in headers, and capital letters in CameraInfo."""
    types = store.types
    if name == "builtin_interfaces/msg/Time":
        return types[name](**fields)
    made = {}
    for key, (kind, detail) in store.fielddefs[name][1]:
        given = fields.get(key, fields.get(key.lower()))
        if kind.name == "NAME":
            made[key] = _message(store, detail, given or {}, first)
        elif kind.name == "SEQUENCE" and detail[0][0].name == "NAME":
            made[key] = [_message(store, detail[0][1], one, first) for one in given]
        elif given is None:
            made[key] = "" if detail[0] == "string" else 0
        else:
            made[key] = given
    return types[name](**made)
