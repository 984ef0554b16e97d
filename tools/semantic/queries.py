"""What a map in tiles says of many points, written block by block to one .npz file.

Knows jobs, tiles and the file's arrays; must not know scans. Memory is that of a block, however many points
there are.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.lib import format as npy

from mapping.files import temporary_beside
from mapping.label_doubt import labels_of
from mapping.multiscale import MultiscaleMap
from tools.semantic.tiles import Job, Tile, ask_tiles

ROWS = 2**18
"""Points that are asked for in one go."""
MAPS = 16
"""Maps of tiles that are kept meanwhile."""


def write_answers(job: Job, tiles: list[Tile], X: np.ndarray, names: Sequence[str], path: Path) -> None:
    """Of points X (N, 3) [m] probabilities (N, C + 1) float32, and label (N,) uint8 and doubt (N,) float32
    of it (see `label_doubt`); classes: names of the columns."""
    from tqdm import tqdm

    load = lru_cache(MAPS)(lambda tile: MultiscaleMap(job.config).load(job.map_file(tile)))
    label, doubt = np.empty(len(X), np.uint8), np.empty(len(X), np.float32)

    def blocks() -> Iterator[np.ndarray]:
        with tqdm(total=len(X), desc="queries", disable=None) as bar:
            for start in range(0, len(X), ROWS):
                part = slice(start, start + ROWS)
                answer = ask_tiles(job, tiles, X[part], load)
                label[part], doubt[part], _ = labels_of(answer)
                yield answer
                bar.update(len(answer))

    with temporary_beside(path) as partial, zipfile.ZipFile(partial, "w") as archive:
        _write(archive, "probabilities", np.float32, (len(X), len(names) + 1), blocks())
        for name, array in (("label", label), ("doubt", doubt), ("classes", np.array([*names, "uncertain"]))):
            _write(archive, name, array.dtype, array.shape, [array])


def _write(
    archive: zipfile.ZipFile,
    name: str,
    kind: np.dtype | type,
    shape: tuple[int, ...],
    parts: Sequence[np.ndarray] | Iterator[np.ndarray],
) -> None:
    """An array of which the parts are the rows, one after the other, as numpy.load reads it."""
    # A member without the time of day: same answers, same bytes.
    with archive.open(zipfile.ZipInfo(f"{name}.npy"), "w", force_zip64=True) as file:
        header = {"descr": npy.dtype_to_descr(np.dtype(kind)), "fortran_order": False, "shape": shape}
        npy.write_array_header_2_0(file, header)
        for part in parts:
            file.write(np.ascontiguousarray(part).tobytes())
