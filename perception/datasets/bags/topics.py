"""Which topics of a bag hold depth, colour, camera and labels: by type and encoding, where only one fits.

Knows topics and their first messages; knows nothing of frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from os.path import commonpath
from typing import Any

import numpy as np

from mapping.errors import FrameError
from perception.datasets.bags.config import BagConfig
from perception.datasets.bags.images import (
    COLOUR,
    COMPRESSED,
    DEPTH,
    LABELS,
    RAW,
    decoded,
    encoding_of,
    size_of,
)
from perception.datasets.bags.opened import OpenBag

INFO = "sensor_msgs/msg/CameraInfo"
MOST_LABELS = 256
"""An image of more numbers is no image of labels, unless it is named."""


@dataclass(frozen=True)
class ImageTopic:
    """A topic of images, as its first message shows it."""

    name: str
    encoding: str
    size: tuple[int, int]
    frame: str
    raw: bool
    first: Any

    def __str__(self) -> str:
        return f"{self.name} ({self.encoding}, {self.size[0]}x{self.size[1]}, {self.frame})"


@dataclass(frozen=True)
class Topics:
    """What is read of a bag; info: the CameraInfo message of the depth image."""

    depth: ImageTopic
    colour: ImageTopic | None
    labels: ImageTopic | None
    info: Any
    info_topic: str


def find_topics(bag: OpenBag, config: BagConfig) -> Topics:
    """The topics that were named, and those that fit alone. Raises FrameError that names the candidates."""
    images = [_image(bag, name) for name in bag.topics(RAW, COMPRESSED)]
    depth = _depth(bag, images, config)
    alike = [one for one in images if one.size == depth.size and one is not depth]
    colour = _one(
        bag, "colour", config.colour, alike, [one for one in alike if one.encoding in COLOUR], depth.frame
    )
    numbered = [one for one in alike if one.encoding in LABELS and _is_labels(one)]
    labels = _one(bag, "labels", config.labels, alike, numbered, depth.frame)
    if labels is not None and labels.frame != depth.frame:
        raise FrameError(
            f"{bag.path}: labels {labels} are of another camera than depth {depth}; give depth aligned to "
            "them"
        )
    name, info = _info(bag, depth, config.info)
    return Topics(depth, colour, labels, info, name)


def _image(bag: OpenBag, name: str) -> ImageTopic:
    message = bag.first(name)
    content = message.content
    return ImageTopic(
        name, encoding_of(content), size_of(content), message.frame, not hasattr(content, "format"), content
    )


def _depth(bag: OpenBag, images: Sequence[ImageTopic], config: BagConfig) -> ImageTopic:
    fitting = [one for one in images if one.encoding in DEPTH]
    if config.depth is None and len(fitting) > 1:
        # Drivers publish depth as the sensor has it and aligned to colour: the second is wanted.
        places = {(one.frame, one.size) for one in images if one.encoding in COLOUR}
        fitting = [one for one in fitting if (one.frame, one.size) in places] or fitting
    found = _one(bag, "depth", config.depth, images, fitting, None)
    if found is None:
        there = "; ".join(map(str, images)) or "none"
        raise FrameError(
            f"{bag.path}: no depth topic (16UC1 or 32FC1); its images are: {there}. Name it with --bag.depth"
        )
    return found


def _one(
    bag: OpenBag,
    kind: str,
    named: str | None,
    images: Sequence[ImageTopic],
    fitting: Sequence[ImageTopic],
    frame: str | None,
) -> ImageTopic | None:
    """The topic that was named, or the only one that fits; of the same images the raw ones."""
    if named is not None:
        found = next((one for one in images if one.name == named), None)
        if found is None:
            there = "; ".join(map(str, images)) or "none"
            raise FrameError(f"{bag.path}: no {kind} topic {named!r} of a fitting size; there are: {there}")
        return found
    if frame is not None and len(fitting) > 1:
        fitting = [one for one in fitting if one.frame == frame] or fitting
    if len(fitting) > 1:
        fitting = [one for one in fitting if one.raw] or fitting
    if len(fitting) > 1:
        raise FrameError(
            f"{bag.path}: several topics could be {kind}: {'; '.join(map(str, fitting))}. Name one with "
            f"--bag.{kind}"
        )
    return fitting[0] if fitting else None


def _is_labels(topic: ImageTopic) -> bool:
    return len(np.unique(decoded(topic.first, topic.name))) <= MOST_LABELS


def _info(bag: OpenBag, depth: ImageTopic, named: str | None) -> tuple[str, Any]:
    names = bag.topics(INFO)
    if named is not None and named not in names:
        raise FrameError(
            f"{bag.path}: no CameraInfo topic {named!r}; there are: {', '.join(names) or 'none'}"
        )
    found = {name: bag.first(name) for name in ([named] if named else names)}
    if named is None:
        found = {
            name: message
            for name, message in found.items()
            if (int(message.content.width), int(message.content.height)) == depth.size
        }
        same = {name: message for name, message in found.items() if message.frame == depth.frame}
        found = same or found
    if not found:
        raise FrameError(
            f"{bag.path}: no CameraInfo of a {depth.size[0]}x{depth.size[1]} image; there are: "
            f"{', '.join(names) or 'none'}. Name one with --bag.info"
        )
    first = next(iter(found))
    matrices = {name: _values(message.content, "k") for name, message in found.items()}
    if any(not np.allclose(K, matrices[first]) for K in matrices.values()):
        # The one that lies beside the image.
        near = {name: len(commonpath([name, depth.name])) for name in found}
        best = [name for name in found if near[name] == max(near.values())]
        if len(best) > 1:
            raise FrameError(
                f"{bag.path}: several CameraInfo topics could be depth's: {', '.join(found)}. Name one with "
                "--bag.info"
            )
        first = best[0]
    return first, found[first].content


def _values(info: Any, name: str) -> np.ndarray:
    """A field of CameraInfo: ROS 1 writes K where ROS 2 writes k."""
    return np.array(getattr(info, name.upper() if hasattr(info, name.upper()) else name), float)


def camera_values(info: Any) -> dict[str, Any]:
    """CameraInfo as camera files have it."""
    return {
        "width": int(info.width),
        "height": int(info.height),
        "K": _values(info, "k").reshape(3, 3).tolist(),
        "D": _values(info, "d").tolist(),
        "distortion_model": str(info.distortion_model),
    }
