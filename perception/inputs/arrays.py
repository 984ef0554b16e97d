"""Arrays in memory, in the forms people have them, as a Frame's fields. Knows no files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mapping.errors import FrameError
from perception.camera import Camera
from perception.inputs.camera_keys import check_scale, matrix_of
from perception.inputs.depth_files import StoredDepth, single_channel, to_metres
from perception.inputs.label_files import mended
from perception.inputs.label_forms import Labels, as_labels, from_masks, on
from perception.inputs.pose import read_pose

SOURCE = "memory"


def frame_arguments(
    depth: Any,
    K: Any,
    masks: Any,
    T_world_camera: Any,
    names: Mapping[int, str] | None,
    rgb: np.ndarray | None,
    depth_scale: float | None,
) -> dict[str, Any]:
    """The fields of a Frame; see Frame.from_arrays. Raises FrameError."""
    scale = None if depth_scale is None else check_scale(depth_scale, SOURCE, "depth_scale")
    stored = StoredDepth(single_channel(np.asarray(depth), SOURCE), Path("depth"))
    metres, notes = to_metres(stored, scale, SOURCE, always=True)
    pose = np.eye(4) if T_world_camera is None else read_pose(T_world_camera, "T_world_camera")
    camera = Camera(matrix_of(K, "K"), metres.shape[1], metres.shape[0], pose)
    labels = None if masks is None else mended(labels_of(masks, tuple(names or ())), "masks")
    own = {} if labels is None else labels.names
    return {
        "depth": metres,
        "camera": camera,
        "rgb": rgb,
        "labels": None if labels is None else labels.image,
        "names": {**own, **{int(label): str(name) for label, name in (names or {}).items()}},
        "source": SOURCE,
        "notes": (*notes, *(() if labels is None else labels.notes)),
    }


def labels_of(masks: Any, named: tuple[int, ...] = ()) -> Labels:
    """Labels from an image, a stack, a list of masks, or masks by label or by name. Raises FrameError."""
    if isinstance(masks, Mapping):
        numbered = all(isinstance(key, (int, np.integer)) for key in masks)
        numbers = [int(key) for key in masks] if numbered else list(range(1, len(masks) + 1))
        found = from_masks({n: on(np.asarray(mask)) for n, mask in zip(numbers, masks.values())}, "masks")
        return Labels(found.image, {} if numbered else {n: str(key) for n, key in zip(numbers, masks)})
    if isinstance(masks, Sequence) and not isinstance(masks, str):
        layers = [np.asarray(mask) for mask in masks]
        if layers and all(layer.ndim == 2 for layer in layers):
            return from_masks({index + 1: on(layer) for index, layer in enumerate(layers)}, "masks")
        raise FrameError("masks: a list must hold one (H, W) mask an object")
    return as_labels(np.asarray(masks), "masks", named)
