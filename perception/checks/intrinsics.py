"""K against the size of its image: matrices of other streams, in other units, or laid out wrongly."""

from __future__ import annotations

import numpy as np

from mapping.errors import FrameError
from perception.camera import Camera

CENTRED = 0.08
"""A principal point this near the middle, as a share of the side, needs no second look."""
OTHER_STREAM = 0.05
"""Twice a principal point lies this near, as a share, to the size of the stream that K was made for."""
LEAST_VIEW, MOST_VIEW = 8.0, 140.0
"""Fields of view between which cameras lie [degrees]."""
SHAPE = 0.03
"""A principal point outside the image is the middle of a larger image of the same shape, to this share."""
TILTED = (6.0, 45.0)
"""Where it lies outside and the world is level, the table's tilt [degrees] between these tells a wrong K: a
level table shows it to be right, a larger tilt that the world is not level."""
SQUARE = 0.12
"""Pixels are square to this share, or fx and fy are worth a note."""
NEVER_SQUARE = 2.0
"""fx and fy that differ by more than this factor are no camera's."""
STREAMS = (
    (160, 120), (176, 132), (224, 171), (320, 180), (320, 240), (384, 288), (424, 240), (480, 270), (480,
    360), (512, 424), (512, 512), (640, 360), (640, 400), (640, 480), (640, 512), (640, 576), (720, 540),
    (720, 720), (800, 600), (848, 480), (960, 540), (960, 720), (1024, 576), (1024, 768), (1024, 1024),
    (1280, 720), (1280, 800), (1280, 960), (1280, 1024), (1440, 1080), (1536, 1024), (1600, 1200), (1920,
    1080), (1920, 1200), (1944, 1200), (2048, 1536), (2208, 1242), (2592, 1944), (3840, 2160), (4032, 3024),
)  # fmt: skip
"""Image sizes that depth and colour cameras offer [px]."""


def check_intrinsics(camera: Camera, source: str, trusted: bool = False) -> list[str]:
    """Notes about K; raises FrameError when it cannot be the matrix of an image of this size.

    trusted: the source vouches for K, so only what is impossible is refused.
    """
    K, width, height = camera.K, camera.width, camera.height
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    # Of a cut image, the whole of which it is a part counts.
    across = float(np.degrees(2 * np.arctan(max(width / 2, width - 0.5 - cx, cx + 0.5) / fx)))
    if not LEAST_VIEW < across < MOST_VIEW:
        unit = (
            f"fractions of the image? Multiply the first row by {width} and the second by {height}"
            if fx < 10 and cx <= 1
            else "it must count in pixels of this image"
        )
        raise FrameError(
            f"{source}: K: fx={fx:g} px gives a {width}x{height} image a view of {across:.3g} degrees; {unit}"
        )
    if max(fx / fy, fy / fx) > NEVER_SQUARE:
        raise FrameError(
            f"{source}: K: fx={fx:g} and fy={fy:g} px differ by a factor of {max(fx / fy, fy / fx):.2g}, "
            f"which no camera "
            "has; check the order (fx 0 cx / 0 fy cy / 0 0 1)"
        )
    notes = []
    if abs(cx / width - 0.5) > CENTRED or abs(cy / height - 0.5) > CENTRED:
        share = f"{100 * cx / width:.0f} % / {100 * cy / height:.0f} %"
        where = (
            f"{source}: K: the principal point ({cx:g}, {cy:g}) lies at {share} of the {width}x{height} image"
        )
        stream = _stream_of(cx, cy, width, height)
        if trusted:
            return []
        if stream is not None:
            raise FrameError(
                f"{where}: K belongs to a {stream[0]}x{stream[1]} image; {_mend(K, stream, width, height)}"
                '; if the image was cut and K is right, add "trust": ["K"] to the camera file (--trust K)'
            )
        notes.append(
            f"{where}: right for a cut image only; if the image was resized, K must be scaled with it"
        )
    if abs(fx / fy - 1) > SQUARE:
        notes.append(f"{source}: K: fx={fx:g} and fy={fy:g} px differ: right for a stretched image only")
    return notes


def check_cut(camera: Camera, normal: np.ndarray, source: str, trusted: bool) -> None:
    """Raise FrameError where the principal point lies outside the image and the support contradicts K.

    normal: (3,) the support's in the camera frame. A wrong K shears the scene, so a level table comes out
    tilted. Without a pose nothing is said.
    """
    if trusted or camera.sees_axis or np.allclose(camera.T_world_camera, np.eye(4)):
        return
    up = camera.T_world_camera[:3, :3] @ normal / np.linalg.norm(normal)
    tilt = float(np.degrees(np.arccos(np.clip(up[2], -1, 1))))
    if TILTED[0] < tilt < TILTED[1]:
        raise FrameError(
            f"{source}: K: the principal point ({camera.K[0, 2]:g}, {camera.K[1, 2]:g}) lies outside the "
            f"{camera.width}x{camera.height} image, and the table tilts {tilt:.0f} degrees against the "
            "world's z: K or the offset of the cut is wrong; if K is right, add "
            '"trust": ["K"] to the camera file (--trust K)'
        )


def _stream_of(cx: float, cy: float, width: int, height: int) -> tuple[int, int] | None:
    """The size of another stream whose middle is the principal point; None for a cut image."""
    size = np.array([2 * cx + 1, 2 * cy + 1])
    if abs(size[0] / height - 1) < OTHER_STREAM and abs(size[1] / width - 1) < OTHER_STREAM:
        return (height, width)  # the image stands upright, or the point's numbers were exchanged
    if (
        (cx >= width or cy >= height)
        and min(size) > 0
        and abs(size[0] / width * height / size[1] - 1) < SHAPE
    ):
        return (round(size[0]), round(size[1]))  # of the same shape: no cut would have just that
    sizes = np.array([*STREAMS, *(tuple(np.multiply((width, height), f)) for f in (0.25, 0.5, 2, 4))])
    off = np.abs(size / sizes - 1).max(1)
    best = int(np.argmin(off))
    found = (int(sizes[best][0]), int(sizes[best][1]))
    return found if off[best] < OTHER_STREAM and found != (width, height) else None


def _mend(K: np.ndarray, stream: tuple[int, int], width: int, height: int) -> str:
    if stream == (height, width):
        return "exchange its rows (cx, cy and fx, fy), or turn the images upright"
    x, y = width / stream[0], height / stream[1]
    if abs(x / y - 1) < 0.01:
        scaled = ", ".join(
            f"{name}={value:.6g}"
            for name, value in (
                ("fx", K[0, 0] * x),
                ("fy", K[1, 1] * y),
                ("cx", (K[0, 2] + 0.5) * x - 0.5),
                ("cy", (K[1, 2] + 0.5) * y - 0.5),
            )
        )
        return f"for a resized image scale it: {scaled}; or take the K of this stream"
    return "the shape differs too, so take the K of this stream (a camera publishes one for each size)"
