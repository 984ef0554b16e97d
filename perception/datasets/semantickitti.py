"""SemanticKITTI: scans of a sequence with the benchmark's 19 classes, moved by their poses.

Knows the data set's folders, files and ids; must not know maps.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mapping.errors import DataError
from perception.labelled_cloud import UNLABELLED, LabelledCloud, checked_cloud

CLASSES = (
    *("car", "bicycle", "motorcycle", "truck", "other-vehicle", "person", "bicyclist", "motorcyclist"),
    *("road", "parking", "sidewalk", "other-ground", "building", "fence", "vegetation", "trunk", "terrain"),
    *("pole", "traffic-sign"),
)
"""The single-scan benchmark's classes in its order."""

RAW_IDS = {
    **{10: "car", 11: "bicycle", 13: "other-vehicle", 15: "motorcycle", 16: "other-vehicle", 18: "truck"},
    **{20: "other-vehicle", 30: "person", 31: "bicyclist", 32: "motorcyclist", 40: "road", 44: "parking"},
    **{48: "sidewalk", 49: "other-ground", 50: "building", 51: "fence", 60: "road", 70: "vegetation"},
    **{71: "trunk", 72: "terrain", 80: "pole", 81: "traffic-sign", 252: "car", 253: "bicyclist"},
    **{254: "person", 255: "motorcyclist", 256: "other-vehicle", 257: "other-vehicle", 258: "truck"},
    259: "other-vehicle",
}
"""Raw id -> class; 60 is lane marking, 252-259 are moving things, folded as the benchmark does."""
IGNORED_IDS = (0, 1, 52, 99)
"""Unlabelled, outlier, other structure, other object: the benchmark does not judge them."""
USUAL_TR = np.array(
    [
        [4.276802385584e-04, -9.999672484946e-01, -8.084491683471e-03, -1.198459927713e-02],
        [-7.210626507497e-03, 8.081198471645e-03, -9.999413164504e-01, -5.403984729748e-02],
        [9.999738645903e-01, 4.859485810390e-04, -7.206933692422e-03, -2.921968648686e-01],
        [0, 0, 0, 1],
    ]
)
"""Scanner to camera of KITTI's first days, for copies whose calib.txt has only the cameras' P0 to P3. Other
days differ by less than a degree and 4 cm."""
POINT_BYTES = 16
LABEL_BYTES = 4


@dataclass(frozen=True)
class KittiSequence:
    """A sequence's folder: velodyne, labels, and, where scans are put together, poses.txt and calib.txt."""

    folder: Path

    def __post_init__(self) -> None:
        if not (self.folder / "velodyne").is_dir():
            raise DataError(f"{self.folder}: no folder velodyne; wanted a sequence such as sequences/00")

    def scans(self) -> list[str]:
        """Names of its scans, such as 000000. Raises DataError when there is none."""
        names = sorted(path.stem for path in (self.folder / "velodyne").glob("*.bin"))
        if not names:
            raise DataError(f"{self.folder / 'velodyne'}: no .bin file")
        return names

    def scan(self, name: str, T_world_scan: np.ndarray | None = None) -> LabelledCloud:
        """A scan in the sensor's frame, or moved by T_world_scan (4, 4)."""
        cloud = read_scan(self.folder / "velodyne" / f"{name}.bin", self.folder / "labels" / f"{name}.label")
        return cloud if T_world_scan is None else cloud.moved(T_world_scan)

    def poses(self) -> np.ndarray:
        """(S, 4, 4) T_world_scan of every scan: Tr^-1 pose Tr. Raises DataError without them."""
        poses = _matrices(self.folder / "poses.txt")
        calibration = self.folder / "calib.txt"
        if not calibration.is_file():
            raise DataError(f"{calibration}: missing; poses are of the camera and need its Tr to move scans")
        lines = [line for line in calibration.read_text().splitlines() if line.startswith("Tr")]
        if not lines:
            return np.linalg.inv(USUAL_TR) @ poses @ USUAL_TR
        try:
            Tr = _square(np.array(lines[0].split(":")[1].split(), float)[None])[0]
        except (IndexError, ValueError) as error:
            raise DataError(f"{calibration}: no line `Tr: ` with 12 numbers") from error
        return np.linalg.inv(Tr) @ poses @ Tr


def read_scan(velodyne: Path, label: Path) -> LabelledCloud:
    """One scan: float32 x y z [m] reflectance, and uint32 labels whose lower half is the raw id.

    Raises DataError for missing or truncated files and for label counts that differ; raw ids that the data
    set does not have count as skipped.
    """
    values = _words(velodyne, POINT_BYTES, np.float32).reshape(-1, 4)
    raw = _words(label, LABEL_BYTES, np.uint32) & 0xFFFF
    if len(raw) != len(values):
        raise DataError(f"{label}: {len(raw)} labels for the {len(values)} points of {velodyne.name}")
    table = np.full(2**16, UNLABELLED, np.int64)
    for number, name in RAW_IDS.items():
        table[number] = CLASSES.index(name)
    known = np.isin(raw, [*RAW_IDS, *IGNORED_IDS])
    skipped = {} if known.all() else {"labels of unknown id": int((~known).sum())}
    name = f"{velodyne.parents[1].name}/{velodyne.stem}"
    return checked_cloud(name, values[:, :3], table[raw], CLASSES, np.zeros(3), skipped)


def _words(path: Path, size: int, kind: type) -> np.ndarray:
    if not path.is_file():
        raise DataError(f"{path}: no such file")
    content = path.read_bytes()
    if len(content) % size:
        raise DataError(f"{path}: {len(content)} bytes, no multiple of {size}; truncated? copy it again")
    if not content:
        raise DataError(f"{path}: empty file")
    return np.frombuffer(content, kind)


def _matrices(path: Path) -> np.ndarray:
    """(S, 4, 4) of a text file with twelve numbers a line."""
    if not path.is_file():
        raise DataError(f"{path}: no poses; scans of a sequence can only be put together with them")
    try:
        rows = np.array([line.split() for line in path.read_text().splitlines() if line.strip()], float)
        return _square(rows)
    except ValueError as error:
        raise DataError(f"{path}: wanted twelve numbers a line ({error})") from error


def _square(rows: np.ndarray) -> np.ndarray:
    matrices = np.tile(np.eye(4), (len(rows), 1, 1))
    matrices[:, :3] = rows.reshape(-1, 3, 4)
    if not np.isfinite(matrices).all():
        raise ValueError("not finite")
    return matrices
