"""Depth from files, whatever holds it: 16-bit images, float TIFF, EXR, PFM, .npy. Knows units, not scenes."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mapping.errors import FrameError
from mapping.guarded_files import check_plain
from perception.image_io import read_array, read_depth_image

SUFFIXES = (".npy", ".png", ".tiff", ".tif", ".exr", ".pfm", ".pgm")
"""Files that depth can be in, in the order they are looked for."""
NO_METRES = 20.0
"""A float depth image whose median is larger is not in metres [m]."""
LEAST_METRES = 0.05
"""Nor is one whose median is smaller [m]."""
INTEGER_TOP = {np.dtype(np.uint16): 65535, np.dtype(np.int16): 32767}
"""Whole numbers that mean "no return": the top of their type."""


@dataclass(frozen=True)
class StoredDepth:
    """Depth (H, W) as stored: whole numbers in units of a scale, or floats; path: where from."""

    values: np.ndarray
    path: Path

    @property
    def whole(self) -> bool:
        """Whether a scale is needed to make metres of it."""
        return bool(np.issubdtype(self.values.dtype, np.integer))


def read_depth(path: Path) -> StoredDepth:
    """Depth of any file named in SUFFIXES. Raises FrameError that names the file and the way to mend it."""
    if path.suffix == ".npy":
        return StoredDepth(single_channel(read_array(path), path), path)
    if path.suffix in (".tif", ".tiff", ".pfm", ".exr"):
        return StoredDepth(single_channel(_read_float_image(path), path), path)
    return StoredDepth(read_depth_image(path), path)


def single_channel(depth: np.ndarray, path: object) -> np.ndarray:
    """Depth (H, W) from (H, W), (H, W, 1) or (1, H, W); numbers only. Raises FrameError."""
    if depth.ndim == 3 and 1 in (depth.shape[0], depth.shape[-1]):
        depth = depth[0] if depth.shape[0] == 1 else depth[..., 0]
    number = np.issubdtype(depth.dtype, np.floating) or np.issubdtype(depth.dtype, np.integer)
    if depth.ndim != 2 or not number or depth.dtype.itemsize == 1:
        raise FrameError(
            f"{path}: depth must be a 2D array of float metres or of 16-bit units, got {depth.dtype} "
            f"{depth.shape}"
        )
    return depth


def to_metres(
    stored: StoredDepth, scale: float | None, said: str, always: bool
) -> tuple[np.ndarray, list[str]]:
    """Depth (H, W) float32 [m], NaN where missing, and what is worth saying.

    scale: metres per unit or None; said: its name, for messages. always: the scale is for floats as well;
    else floats are metres, unless they cannot be metres and the scale that was given makes them so.
    """
    values, path, notes = stored.values, stored.path, []
    if stored.whole:
        if scale is None:
            raise FrameError(
                f"{said}: lacks depth_scale, the metres per unit of {path.name} (0.001 for millimetres)"
            )
        top = INTEGER_TOP.get(values.dtype)
        ceiling = (values == top) if top is not None else np.zeros(values.shape, bool)
        if count := int(ceiling.sum()):
            notes.append(f"{path.name}: {count} pixels hold {top}, the top of their type: taken as missing")
        metres = values.astype(np.float32) * np.float32(scale)
        metres[ceiling] = np.nan
        return metres, notes
    metres = values.astype(np.float32)
    if scale is None or scale == 1:
        return metres, notes
    measured = metres[np.isfinite(metres) & (metres > 0)]
    median = float(np.median(measured)) if measured.size else 1.0
    unlike = not LEAST_METRES <= median <= NO_METRES
    if always or (unlike and LEAST_METRES <= median * scale <= NO_METRES):
        if not always:
            notes.append(
                f"{path.name}: a median of {median:.4g} cannot be metres, so depth_scale {scale:g} was "
                f"applied to it"
            )
        return metres * np.float32(scale), notes
    return metres, notes


def _read_float_image(path: Path) -> np.ndarray:
    check_plain(path, "it must be a depth image", FrameError)
    if path.suffix == ".exr":
        return _read_exr(path)
    import cv2

    image = cv2.imread(os.fspath(path), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise FrameError(f"{path}: damaged or cut short, or not an image; copy or save it again")
    return np.asarray(image)


def _read_exr(path: Path) -> np.ndarray:
    try:
        import OpenEXR
    except ImportError as error:
        raise FrameError(f"{path}: EXR needs OpenEXR: pip install 'contramap[inputs]'") from error
    try:
        with OpenEXR.File(os.fspath(path), separate_channels=True) as file:
            channels = {name: np.array(channel.pixels) for name, channel in file.channels().items()}
    except Exception as error:  # OpenEXR raises whatever its C++ side throws
        raise FrameError(f"{path}: damaged or not an EXR image; save it again") from error
    name = next((key for key in ("Z", "depth.Z", "depth.V", "V", "Y", "R") if key in channels), None)
    name = name or next(iter(channels), None)
    if name is None:
        raise FrameError(f"{path}: holds no channel")
    depth = channels[name]
    if depth.ndim == 3:  # channels come grouped as RGB
        depth = depth[..., 0]
    depth = depth.astype(np.float32)
    depth[depth > 1e9] = np.nan  # Blender writes 1e10 where nothing was hit
    return depth
