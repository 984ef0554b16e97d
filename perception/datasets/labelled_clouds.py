"""Labelled clouds in files of common formats: .npz, .ply, .las and .laz.

Knows these formats; must not know maps.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mapping.errors import DataError
from perception.labelled_cloud import LabelledCloud, checked_cloud

LABEL_FIELDS = ("label", "labels", "class", "classification", "scalar_label", "scalar_Label", "semantic")
"""Names under which a .ply may hold its labels."""


def read_cloud(path: Path) -> LabelledCloud:
    """A labelled cloud by its file's ending.

    .npz: `points` (N, 3) [m], `labels` (N,) with -1 for none, optional `names` and `origin` (3,) [m]; .ply:
    vertices with a property label (or class, classification); .las, .laz: points with their classification.
    Raises DataError for anything else.
    """
    if not path.is_file():
        raise DataError(f"{path}: no such file")
    readers = {".npz": _read_npz, ".ply": _read_ply, ".las": _read_las, ".laz": _read_las}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise DataError(
            f"{path}: cannot read {path.suffix or 'files without ending'}; use {', '.join(readers)}"
        )
    return reader(path)


def _read_npz(path: Path) -> LabelledCloud:
    from mapping.guarded_files import read_npz

    arrays = read_npz(path)
    missing = [name for name in ("points", "labels") if name not in arrays]
    if missing:
        raise DataError(f"{path}: no array {missing[0]!r}; wanted points (N, 3) and labels (N,)")
    names = tuple(str(name) for name in arrays["names"]) if "names" in arrays else None
    origin = arrays.get("origin")
    if origin is not None and (origin.shape != (3,) or not np.isfinite(origin).all()):
        raise DataError(f"{path}: origin must be three finite numbers [m], got shape {origin.shape}")
    return _cloud(path, arrays["points"], arrays["labels"], names, origin)


def _read_ply(path: Path) -> LabelledCloud:
    import open3d

    with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
        cloud = open3d.t.io.read_point_cloud(path)
    if "positions" not in cloud.point or not len(cloud.point.positions):
        raise DataError(f"{path}: no vertices could be read; is this a .ply of points?")
    field = next((name for name in LABEL_FIELDS if name in cloud.point), None)
    if field is None:
        found = sorted(key for key, _ in cloud.point.items())
        raise DataError(f"{path}: no property label (found {', '.join(found)}); name it label")
    labels = cloud.point[field].numpy().reshape(-1)
    return _cloud(path, cloud.point.positions.numpy(), labels, None, None)


def _read_las(path: Path) -> LabelledCloud:
    try:
        import laspy
    except ImportError as error:
        raise DataError(f"{path}: needs laspy: pip install 'contramap[cluster]'") from error
    try:
        stored = laspy.read(path)
    except (laspy.LaspyException, ValueError, OSError, EOFError) as error:
        raise DataError(f"{path}: not a readable .las or .laz file ({error})") from error
    return _cloud(path, np.asarray(stored.xyz), np.asarray(stored.classification), None, None)


def _cloud(
    path: Path,
    points: np.ndarray,
    labels: np.ndarray,
    names: tuple[str, ...] | None,
    origin: np.ndarray | None,
) -> LabelledCloud:
    """Labels as they are with names; without, each label found becomes a class named by its number."""
    labels = np.asarray(labels)
    if labels.dtype.kind == "f" and np.isfinite(labels).all() and (labels == np.rint(labels)).all():
        labels = labels.astype(np.int64)
    if names is None and labels.ndim == 1 and labels.dtype.kind in "iu" and len(labels):
        labels = labels.astype(np.int64)
        found = np.unique(labels[labels >= 0])
        labels = np.where(labels >= 0, np.searchsorted(found, labels), -1)
        names = tuple(str(number) for number in found)
    return checked_cloud(path.name, points, labels, names or (), origin)
