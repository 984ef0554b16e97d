"""Lens distortion: coefficients as camera files write them, and images freed of it with OpenCV."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mapping.errors import FrameError

BROWN = {
    "plumb_bob",
    "rational_polynomial",
    "brown_conrady",
    "opencv",
    "radtan",
    "pinhole",
    "standard",
    "perspective",
}
"""Names of OpenCV's own model (k1 k2 p1 p2 [k3 [k4 k5 k6 [s1..s4 [tx ty]]]])."""
FISHEYE = {"equidistant", "fisheye", "kannala_brandt4", "kannala_brandt", "opencv_fisheye"}
"""Names of the fisheye model (k1 k2 k3 k4)."""
COUNTS = (4, 5, 8, 12, 14)
"""Numbers of coefficients that OpenCV's model can have."""


@dataclass(frozen=True)
class Distortion:
    """coefficients: (N,) as OpenCV orders them; fisheye: whether they are of the equidistant model."""

    coefficients: np.ndarray
    fisheye: bool = False

    @property
    def model(self) -> str:
        """The model in words."""
        return "fisheye" if self.fisheye else "Brown-Conrady"


def read_distortion(values: Any, model: Any, name: str) -> Distortion | None:
    """Coefficients as a camera file gives them; None when all are 0. Raises FrameError for unknown models."""
    try:
        coefficients = np.array(values, dtype=np.float64).reshape(-1)
    except (TypeError, ValueError) as error:
        raise FrameError(f"{name}: distortion must be a list of numbers") from error
    if not np.isfinite(coefficients).all():
        raise FrameError(f"{name}: distortion holds NaN or infinite values")
    if not coefficients.any():
        return None
    word = str(model or "plumb_bob").lower().split(".")[-1].replace(" ", "_").replace("-", "_")
    if word in FISHEYE and coefficients.size == 4:
        return Distortion(coefficients, fisheye=True)
    if word in BROWN and coefficients.size in COUNTS:
        return Distortion(coefficients)
    raise FrameError(
        f"{name}: distortion model {word!r} with {coefficients.size} coefficients is not known; "
        "undistort the images first, or give plumb_bob (k1 k2 p1 p2 k3) or equidistant (k1 k2 k3 k4)"
    )


def undistort(
    distortion: Distortion, K: np.ndarray, depth: np.ndarray, *images: np.ndarray | None
) -> tuple[np.ndarray, list[np.ndarray | None]]:
    """Depth (H, W) [m, NaN where missing] and other images as a camera with the same K and no distortion
    sees them. Colour is interpolated, depth and labels are taken from the nearest pixel."""
    import cv2

    size = (depth.shape[1], depth.shape[0])
    if distortion.fisheye:
        maps = cv2.fisheye.initUndistortRectifyMap(
            K, distortion.coefficients, np.eye(3), K, size, cv2.CV_32FC1
        )
    else:
        maps = cv2.initUndistortRectifyMap(K, distortion.coefficients, np.eye(3), K, size, cv2.CV_32FC1)
    flat = cv2.remap(depth.astype(np.float32), *maps, cv2.INTER_NEAREST, borderValue=float("nan"))
    others = [
        None
        if image is None
        else cv2.remap(
            image if image.ndim == 3 else image.astype(np.float32),
            *maps,
            cv2.INTER_LINEAR if image.ndim == 3 else cv2.INTER_NEAREST,
            borderValue=0,
        ).astype(image.dtype)
        for image in images
    ]
    return flat, others
