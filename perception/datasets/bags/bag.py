"""Frames from a ROS 1 or ROS 2 bag: depth, colour, camera, labels, and the camera's pose from tf.

Knows which messages make a frame; knows nothing of how they are stored.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from mapping.errors import FrameError
from perception.datasets.bags.config import BagConfig
from perception.datasets.bags.images import decoded
from perception.datasets.bags.opened import OpenBag, opened
from perception.datasets.bags.topics import ImageTopic, Topics, camera_values, find_topics
from perception.datasets.bags.transforms import SECOND, Transforms
from perception.datasets.sequence import Shot
from perception.frame import Frame
from perception.inputs.assemble import Parts, assemble
from perception.inputs.camera_keys import camera_from_keys
from perception.inputs.depth_files import StoredDepth
from perception.inputs.label_files import mended
from perception.inputs.label_forms import Labels, as_labels

TF = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
STATIC = "tf_static"
TOGETHER = 0.05
"""Colour and labels belong to a depth image whose stamp is this near [s]."""
COVERED = 0.5
"""A time asked for may lie this far from the nearest depth image [s]."""
MILLIMETRE = 1e-3
EPOCH = 1e8
"""Seconds beyond this count from 1970, others from the first depth image on."""


@dataclass(frozen=True)
class Bag:
    """A bag whose topics are known. index: topic -> (stamp, recorded) [ns] of its images, by stamp."""

    path: Path
    topics: Topics
    transforms: Transforms
    index: dict[str, list[tuple[int, int]]]
    fixed_frame: str
    trust: tuple[str, ...] = ()

    @classmethod
    def open(cls, path: str | Path, config: BagConfig | None = None, trust: Sequence[str] = ()) -> Bag:
        """Find topics, read tf and the stamps of all images. Raises FrameError that says what is missing."""
        config = config or BagConfig()
        with opened(Path(path)) as bag:
            topics = find_topics(bag, config)
            transforms = _transforms(bag)
            images = [one for one in (topics.depth, topics.colour, topics.labels) if one is not None]
            index: dict[str, list[tuple[int, int]]] = {one.name: [] for one in images}
            for message in bag.messages(list(index)):
                index[message.topic].append((message.stamp, message.recorded))
        camera = topics.depth.frame
        if not transforms.edges and config.fixed_frame != camera:
            raise FrameError(
                f"{path}: no tf, so where the camera is is not known; where it stands still, say "
                f"--bag.fixed-frame {camera}"
            )
        fixed = config.fixed_frame or transforms.root(camera)
        if fixed == camera and config.fixed_frame is None:
            raise FrameError(
                f"{path}: tf does not say where {camera} is; its frames are: {', '.join(transforms.frames)}. "
                f"Where the camera stands still, say --bag.fixed-frame {camera}"
            )
        for entries in index.values():
            entries.sort()
        return cls(Path(path), topics, transforms, index, fixed, tuple(trust))

    @cached_property
    def stamps(self) -> list[int]:
        """When each depth image was taken [ns]."""
        return [stamp for stamp, _ in self.index[self.topics.depth.name]]

    def seconds(self, stamp: int) -> float:
        """Seconds from the first depth image on."""
        return (stamp - self.stamps[0]) / SECOND

    def nearest(self, at: float) -> int:
        """The stamp [ns] of the depth image nearest to a time: seconds from the first on, or since 1970.
        Raises FrameError when the bag does not cover it."""
        # In whole nanoseconds: as a float, a stamp since 1970 is exact to 0.2 microseconds only.
        wanted = round(at * SECOND) + (0 if abs(at) > EPOCH else self.stamps[0])
        stamp = min(self.stamps, key=lambda one: abs(one - wanted))
        if abs(stamp - wanted) > COVERED * SECOND:
            last = self.seconds(self.stamps[-1])
            raise FrameError(
                f"{self.path}: no depth image within {COVERED} s of {at:g} s; it has {len(self.stamps)} from "
                f"0 to {last:.3f} s (since 1970: {self.stamps[0] / SECOND:.3f} to "
                f"{self.stamps[-1] / SECOND:.3f})"
            )
        return stamp

    def frame(self, stamp: int) -> Frame:
        """The frame whose depth image was taken at a stamp [ns]. Raises FrameError."""
        source = f"{self.path} at {self.seconds(stamp):.3f} s"
        topics = self.topics
        with opened(self.path) as bag:
            depth = self._image(bag, topics.depth, stamp, 0)
            colour = self._image(bag, topics.colour, stamp, round(TOGETHER * SECOND))
            numbers = self._image(bag, topics.labels, stamp, round(TOGETHER * SECOND))
        assert depth is not None
        notes = []
        if topics.colour is not None and colour is None:
            notes.append(f"no colour image within {TOGETHER} s")
        if topics.colour is not None and topics.colour.frame != topics.depth.frame:
            notes.append(f"colour is of {topics.colour.frame}, depth of {topics.depth.frame}: not aligned?")
        if topics.labels is not None and numbers is None:
            raise FrameError(f"{source}: no image of {topics.labels.name} within {TOGETHER} s")
        labels: Labels | None = None
        if numbers is not None and topics.labels is not None:
            labels = mended(as_labels(numbers, topics.labels.name), topics.labels.name)
        try:
            pose = self.transforms.pose(topics.depth.frame, self.fixed_frame, stamp)
        except FrameError as error:
            raise FrameError(f"{source}: {error}") from error
        camera = camera_from_keys(camera_values(topics.info), topics.info_topic)
        stored = StoredDepth(depth, Path(topics.depth.name))
        return assemble(
            Parts(
                depth=stored,
                camera=replace(
                    camera,
                    depth_scale=MILLIMETRE if stored.whole else None,
                    T_world_camera=pose,
                    trust=(*camera.trust, *self.trust),
                ),
                camera_name=topics.info_topic,
                source=source,
                rgb=_rgb(colour),
                labels=labels,
                scale_name=topics.depth.name,
                notes=tuple(notes),
            )
        )

    def _image(self, bag: OpenBag, topic: ImageTopic | None, stamp: int, within: int) -> np.ndarray | None:
        """The image of a topic nearest to a stamp, None when none is as near as `within` [ns]."""
        if topic is None:
            return None
        entries = self.index[topic.name]
        place = bisect_left(entries, (stamp, 0))
        near = entries[max(place - 1, 0) : place + 2]
        found, recorded = min(near, key=lambda entry: abs(entry[0] - stamp))
        if abs(found - stamp) > within:
            return None
        for message in bag.messages([topic.name], recorded, recorded + 1):
            if message.stamp == found:
                return decoded(message.content, topic.name)
        raise FrameError(
            f"{self.path}: the image of {topic.name} at {found / SECOND:.3f} s is not there any more"
        )


def load_bag(
    path: str | Path, at: float = 0.0, config: BagConfig | None = None, trust: Sequence[str] = ()
) -> Frame:
    """One frame of a bag: that of the depth image nearest to `at` [s], counted from the first one on, or
    since 1970. Raises FrameError that says which topic, transform or time is missing."""
    bag = Bag.open(path, config, trust)
    return bag.frame(bag.nearest(at))


def shots_of_bag(path: str | Path, config: BagConfig | None = None, trust: Sequence[str] = ()) -> list[Shot]:
    """All frames of a bag in order, or one in every config.every seconds. Raises FrameError."""
    config = config or BagConfig()
    bag = Bag.open(path, config, trust)
    chosen: list[int] = []
    for stamp in bag.stamps:
        if not chosen or stamp - chosen[-1] >= config.every * SECOND:
            chosen.append(stamp)

    def shot(stamp: int) -> Shot:
        return Shot(f"{bag.seconds(stamp):.3f} s", lambda: bag.frame(stamp), stamp / SECOND)

    return [shot(stamp) for stamp in chosen]


def _rgb(image: np.ndarray | None) -> np.ndarray | None:
    """(H, W, 3) uint8, grey values in all channels."""
    if image is None:
        return None
    return image if image.ndim == 3 else np.repeat(image[..., None].astype(np.uint8), 3, axis=2)


def _transforms(bag: OpenBag) -> Transforms:
    found = Transforms()
    for message in bag.messages(bag.topics(*TF)):
        found.add(message.content.transforms, message.topic.rstrip("/").endswith(STATIC))
    return found
