"""Image messages as arrays. Knows encodings; knows nothing of topics or bags."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from mapping.errors import FrameError

RAW = "sensor_msgs/msg/Image"
COMPRESSED = "sensor_msgs/msg/CompressedImage"
DEPTH = ("16UC1", "32FC1")
COLOUR = ("rgb8", "bgr8", "rgba8", "bgra8", "bayer_rggb8", "bayer_bggr8", "bayer_gbrg8", "bayer_grbg8")
LABELS = ("mono16", "32SC1")
"""Encodings that labels are found by; mono8 and 8UC1 are taken where the topic is named."""
TYPES = {
    "8UC1": "u1", "mono8": "u1", "16UC1": "u2", "mono16": "u2", "16SC1": "i2", "32SC1": "i4", "32FC1": "f4",
}  # fmt: skip
BAYER = {
    "bayer_rggb8": cv2.COLOR_BayerBG2RGB,
    "bayer_bggr8": cv2.COLOR_BayerRG2RGB,
    "bayer_gbrg8": cv2.COLOR_BayerGR2RGB,
    "bayer_grbg8": cv2.COLOR_BayerGB2RGB,
}
DEPTH_HEADER = 12
"""Bytes before the PNG of a compressedDepth image: format, and two floats of its quantisation."""


def encoding_of(message: Any) -> str:
    """The encoding of an Image or CompressedImage; "jpeg" and the like are colour: "rgb8"."""
    if hasattr(message, "encoding"):
        return str(message.encoding)
    words = str(message.format)
    first = words.split(";")[0].strip()
    return first if "compressedDepth" in words or first in (*TYPES, *COLOUR) else "rgb8"


def size_of(message: Any) -> tuple[int, int]:
    """Width and height [px]."""
    if hasattr(message, "width"):
        return int(message.width), int(message.height)
    image = decoded(message, "image")
    return image.shape[1], image.shape[0]


def decoded(message: Any, name: str) -> np.ndarray:
    """(H, W) depth, labels or grey values as stored, or (H, W, 3) uint8 RGB. Raises FrameError."""
    if hasattr(message, "format"):
        return _decompressed(message, name)
    encoding, width, height = str(message.encoding), int(message.width), int(message.height)
    channels = {"rgb8": 3, "bgr8": 3, "rgba8": 4, "bgra8": 4}.get(encoding, 1)
    kind = "u1" if channels > 1 or encoding in BAYER else TYPES.get(encoding)
    if kind is None:
        raise FrameError(
            f"{name}: encoding {encoding!r} is not known; known are {', '.join((*TYPES, *COLOUR))}"
        )
    dtype = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    row = width * channels * dtype.itemsize
    data = np.asarray(message.data, np.uint8)
    step = int(message.step) or row
    if step < row or data.size < step * height:
        raise FrameError(f"{name}: {data.size} bytes are too few for {width}x{height} {encoding}")
    rows = np.ascontiguousarray(data[: step * height].reshape(height, step)[:, :row])
    image = rows.view(dtype).reshape(height, width, channels)
    if channels == 1:
        grey = image[..., 0].astype(dtype.newbyteorder("="))
        return cv2.cvtColor(grey, BAYER[encoding]) if encoding in BAYER else grey
    colour = image[..., :3] if encoding.startswith("rgb") else image[..., 2::-1]
    return np.ascontiguousarray(colour)


def _decompressed(message: Any, name: str) -> np.ndarray:
    data = np.asarray(message.data, np.uint8)
    words = str(message.format)
    depth = "compressedDepth" in words
    image = cv2.imdecode(data[DEPTH_HEADER if depth else 0 :], cv2.IMREAD_UNCHANGED)
    if image is None:
        raise FrameError(f"{name}: its compressed image ({words!r}) cannot be decoded")
    if depth and words.startswith("32FC1"):
        a, b = np.frombuffer(data[4:DEPTH_HEADER].tobytes(), "<f4")
        with np.errstate(divide="ignore"):
            metres = a / (image.astype(np.float32) - b)
        return np.where(image > 0, metres, np.float32(np.nan)).astype(np.float32)
    if image.ndim == 3:
        return np.ascontiguousarray(image[..., 2::-1])
    return image
