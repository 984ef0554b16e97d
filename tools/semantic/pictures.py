"""What is looked at: a coloured cloud, the map from above, a recording that grows scan by scan.

Knows the voxel store and class numbers; must not know how the map was made.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mapping.errors import ConfigError
from mapping.files import temporary_beside, write_atomically
from perception.labelled_cloud import LabelledCloud
from reconstruction.pictures.palette import object_colour
from tools.semantic.tiles import NOTHING

UNSURE = 0.5
"""Voxels with a larger p(uncertain) are left out of cloud and picture."""


def class_colours(count: int) -> np.ndarray:
    """(count + 1, 3) uint8 colours of the classes, white last."""
    colours = [object_colour(k + 1)[:3] for k in range(count)]
    return np.array([*colours, (255, 255, 255)], np.uint8)


def write_cloud(out: Path, names: Sequence[str]) -> None:
    """cloud.ply: centres [m] of the voxels that were observed, coloured by class, with their label, its doubt
    and p(uncertain)."""
    store = _store(out)
    label = store["label"][:]
    uncertain = store["uncertain"][:]
    sure = (label != NOTHING) & (uncertain <= UNSURE)
    cell = np.argwhere(sure)
    points = np.asarray(store.attrs["origin_m"]) + (cell + 0.5) * store.attrs["voxel_m"]
    kinds = [("xyz", "<f4", 3), ("rgb", "u1", 3), ("label", "u1"), ("doubt", "<f4"), ("uncertain", "<f4")]
    rows = np.empty(len(cell), kinds)
    rows["xyz"], rows["label"] = points, label[sure]
    rows["doubt"], rows["uncertain"] = store["doubt"][:][sure], uncertain[sure]
    rows["rgb"] = class_colours(len(names))[label[sure]]
    header = [
        "ply",
        "format binary_little_endian 1.0",
        *(f"comment class {i} {n}" for i, n in enumerate(names)),
    ]
    header += [f"element vertex {len(rows)}", *(f"property float {axis}" for axis in "xyz")]
    header += [f"property uchar {name}" for name in ("red", "green", "blue", "label")]
    header += [f"property float {name}" for name in ("doubt", "uncertain")]
    write_atomically(out / "cloud.ply", ("\n".join([*header, "end_header"]) + "\n").encode() + rows.tobytes())


def draw_above(out: Path, names: Sequence[str]) -> None:
    """map.png: for each column the class of its highest sure voxel."""
    from PIL import Image

    store = _store(out)
    label = store["label"][:]
    sure = (label != NOTHING) & (store["uncertain"][:] <= UNSURE)
    top = label.shape[2] - 1 - sure[:, :, ::-1].argmax(axis=2)
    seen = np.take_along_axis(label, top[:, :, None], axis=2)[:, :, 0]
    seen = np.where(sure.any(axis=2), seen, len(names))
    image = Image.fromarray(class_colours(len(names))[np.flipud(seen.T)])
    buffer = io.BytesIO()
    image.save(buffer, format="png", optimize=True)
    write_atomically(out / "map.png", buffer.getvalue())


def record_scans(clouds: Sequence[LabelledCloud], out: Path, path: Path) -> None:
    """A rerun recording: on the timeline `scan` each scan's points as measured, and the map's points so far.

    Raises ConfigError without rerun.
    """
    try:
        import rerun as rr
    except ImportError as error:
        raise ConfigError("--rrd needs rerun: pip install 'contramap[viz]'") from error
    store = _store(out)
    label, voxel = store["label"][:], float(store.attrs["voxel_m"])
    colours = class_colours(len(clouds[0].names))
    path.parent.mkdir(parents=True, exist_ok=True)
    with temporary_beside(path) as partial:
        stream = rr.RecordingStream("contramap-semantic")
        stream.save(partial)
        for number, cloud in enumerate(clouds):
            stream.set_time("scan", sequence=number)
            measured = rr.Points3D(cloud.points, colors=colours[cloud.labels], radii=voxel / 8)
            stream.log("world/scan", measured)
            cell = np.unique(((cloud.points - store.attrs["origin_m"]) / voxel).astype(int), axis=0)
            mapped = label[tuple(cell.T)]
            cell, mapped = cell[mapped != NOTHING], mapped[mapped != NOTHING]
            centres = np.asarray(store.attrs["origin_m"]) + (cell + 0.5) * voxel
            # An entity a scan: what was mapped stays when the next scan comes.
            points = rr.Points3D(centres, colors=colours[mapped], radii=voxel / 2)
            stream.log(f"world/map/{number:04d}", points)
        stream.flush()
        stream.disconnect()


def _store(out: Path) -> Any:
    import zarr

    return zarr.open_group(out / "voxels.zarr", mode="r")
