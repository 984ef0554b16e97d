"""A ROS 1 or ROS 2 bag opened by rosbags: connections and decoded messages. No ROS installation is needed.

Knows how bags are stored; knows nothing of images or transforms. Whatever a damaged bag makes the readers
raise becomes one FrameError.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mapping.errors import ContraMapError, FrameError

METADATA = "metadata.yaml"
"""Makes a folder a ROS 2 bag."""
REINDEX = (
    "was the recorder stopped in the middle? `rosbag reindex`, `ros2 bag reindex` or `mcap recover` mend it"
)


@dataclass(frozen=True)
class Message:
    """One message: its topic, when it was recorded [ns], and rosbags' object of its type."""

    topic: str
    recorded: int
    content: Any

    @property
    def stamp(self) -> int:
        """When its content was measured [ns]; when it was recorded, where the header does not say."""
        stamp = self.content.header.stamp
        return (int(stamp.sec) * 10**9 + int(stamp.nanosec)) or self.recorded

    @property
    def frame(self) -> str:
        """The tf frame of its content."""
        return str(self.content.header.frame_id).lstrip("/")


@dataclass(frozen=True)
class OpenBag:
    """A bag while it is open. reader: rosbags' AnyReader."""

    path: Path
    reader: Any

    def topics(self, *types: str) -> list[str]:
        """Topics with messages of one of these types, by name."""
        return sorted({c.topic for c in self.reader.connections if c.msgtype in types and c.msgcount})

    def messages(
        self, topics: Sequence[str], start: int | None = None, stop: int | None = None
    ) -> Iterator[Message]:
        """Messages of some topics in the order in which they were recorded, between two times [ns]."""
        wanted = [c for c in self.reader.connections if c.topic in topics]
        if not wanted:
            return
        for connection, recorded, raw in self.reader.messages(connections=wanted, start=start, stop=stop):
            yield Message(connection.topic, recorded, self.reader.deserialize(raw, connection.msgtype))

    def first(self, topic: str) -> Message:
        """The first message of a topic."""
        return next(self.messages([topic]))


def is_bag(path: Path) -> bool:
    """Whether a path looks like a bag: .bag, .mcap, .db3, or a folder with metadata.yaml."""
    path = Path(path)
    return path.suffix in (".bag", ".mcap", ".db3") or (path / METADATA).is_file()


@contextmanager
def opened(path: Path) -> Iterator[OpenBag]:
    """A bag for reading. Raises FrameError when it is missing, cut short or damaged, or without rosbags."""
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise FrameError(f"bags need rosbags ({error}): pip install 'contramap[inputs]'") from error
    place = _place(Path(path))
    try:
        # Older ROS 2 bags hold no definitions of their messages.
        store = get_typestore(Stores.ROS2_HUMBLE)
        with AnyReader([place], default_typestore=store) as reader:
            yield OpenBag(Path(path), reader)
    except (ContraMapError, MemoryError):
        raise
    except Exception as error:  # whatever the readers of several formats make of damaged bytes
        reason = " ".join(str(error).split()) or type(error).__name__
        raise FrameError(f"{path}: not a readable bag ({reason}); {REINDEX}") from error


def _place(path: Path) -> Path:
    """What rosbags opens: the folder of a ROS 2 bag, whichever of its files was given."""
    if not path.exists():
        raise FrameError(f"{path}: no such bag")
    if path.suffix in (".mcap", ".db3"):
        if not (path.parent / METADATA).is_file():
            raise FrameError(
                f"{path}: has no {METADATA} beside it; `ros2 bag reindex {path.parent}` makes one, then give "
                "the folder"
            )
        return path.parent
    return path
