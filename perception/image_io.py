"""Single images and arrays from and to files, checked for type. Pillow refuses truncated files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mapping.errors import FrameError
from mapping.files import temporary_beside
from mapping.guarded_files import BROKEN, check_plain, read_npy

LARGEST_IMAGE = 2**26
"""Pixels of the largest image that is read: 8192 x 8192."""


def read_rgb(path: Path) -> np.ndarray:
    """Colour image (H, W, 3) uint8; grey images are spread to three channels, alpha is dropped."""
    image, mode = _read_image(path, "an 8-bit RGB image")
    if image.dtype != np.uint8 or mode == "P":
        raise FrameError(f"{path}: must be an 8-bit RGB image, got mode {mode} ({image.dtype})")
    if image.ndim == 2:
        return np.repeat(image[..., None], 3, axis=2)
    if image.shape[2] == 2:  # grey with alpha
        return np.repeat(image[..., :1], 3, axis=2)
    return np.ascontiguousarray(image[..., :3])


def read_depth_image(path: Path) -> np.ndarray:
    """Depth image (H, W) uint16 in sensor units."""
    image, mode = _read_image(path, "a 16-bit depth image")
    if image.ndim != 2:
        raise FrameError(
            f"{path}: must have one channel, got {image.shape[2]} (mode {mode}); this looks like a coloured "
            "picture of depth: save the raw 16-bit depth"
        )
    if mode != "P" and image.dtype in (np.dtype(np.uint16), np.dtype(np.int32)):
        if image.min() < 0 or image.max() > 65535:
            raise FrameError(f"{path}: depth units must lie in 0..65535; save a 16-bit image or depth.npy")
        return image.astype(np.uint16)
    raise FrameError(
        f"{path}: must be a 16-bit image, got mode {mode} ({image.dtype}), which is too coarse for depth; "
        "save uint16 or float metres as depth.npy"
    )


def read_label_image(path: Path) -> np.ndarray:
    """Labels (H, W) of an image with one channel, with a palette (its indices), or with three equal
    channels."""
    image, mode = _read_image(path, "a label image")
    if image.ndim == 3:
        colours = image[..., :3] if image.shape[2] >= 3 else image[..., :1]
        if (colours != colours[..., :1]).any():
            raise FrameError(
                f"{path}: labels must have one channel with whole numbers, got {image.shape[2]} (mode "
                f"{mode}); a "
                "coloured picture of labels cannot be used: save the numbers, or one mask an object in masks/"
            )
        image = colours[..., 0]
    return image


def read_array(path: Path) -> np.ndarray:
    """The array of a .npy file; pickled objects are refused."""
    return read_npy(path, FrameError)


def write_png(path: Path, image: np.ndarray) -> None:
    """Write an image, whole or not at all. Raises DataError when it cannot be written."""
    from PIL import Image

    picture = Image.fromarray(image)
    with temporary_beside(path) as unfinished:
        picture.save(unfinished, format="PNG", compress_level=3)


def _read_image(path: Path, wanted: str) -> tuple[np.ndarray, str]:
    """Pixels and Pillow's mode of an image file."""
    from PIL import Image, UnidentifiedImageError

    check_plain(path, f"it must be {wanted}", FrameError)
    try:
        with Image.open(path) as image:
            if image.width * image.height > LARGEST_IMAGE:
                raise ValueError(f"{image.width}x{image.height} pixels")
            image.load()
            return np.array(image), image.mode
    except UnidentifiedImageError as error:
        raise FrameError(f"{path}: not an image; it must be {wanted}") from error
    # Pillow reports broken PNG chunks as SyntaxError and absurd sizes as DecompressionBombError.
    except (*BROKEN, Image.DecompressionBombError) as error:
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise FrameError(f"{path}: damaged or cut short ({reason}); copy or save it again") from error
