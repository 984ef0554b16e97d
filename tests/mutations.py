"""Frames changed at random in ways files really break: bytes, JSON fields, shapes, NaN, extremes.

Each mutation is a function of a frame folder and a generator; the same seed makes the same change.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

FILES = ("depth.png", "rgb.png", "labels.png", "camera.json", "names.json")
ODD_VALUES: tuple[Any, ...] = (
    None, 0, -1, 1, 2, 7, 255, 65535, 10**9, -(10**9), 10**30, 1e-300, 1e300, float("nan"), float("inf"),
    True, "", "x", "\ud800", [], [0], [[1, 2], [3, 4]], {}, {"a": 1}, [1e9] * 16,
)  # fmt: skip


def mutate(folder: Path, rng: np.random.Generator) -> str:
    """Change one to three things in a frame folder; what was done, for messages."""
    chosen = [MUTATIONS[int(rng.integers(len(MUTATIONS)))] for _ in range(int(rng.choice([1, 1, 1, 2, 3])))]
    return ", ".join(f"{change.__name__}: {change(folder, rng)}" for change in chosen)


def flip_bytes(folder: Path, rng: np.random.Generator) -> str:
    path = _file(folder, rng)
    content = bytearray(path.read_bytes())
    for place in rng.integers(max(len(content), 1), size=int(rng.choice([1, 3, 30]))):
        if content:
            content[place] = int(rng.integers(256))
    path.write_bytes(content)
    return path.name


def cut(folder: Path, rng: np.random.Generator) -> str:
    path = _file(folder, rng)
    content = path.read_bytes()
    path.write_bytes(content[: int(len(content) * rng.random())])
    return path.name


def insert_or_repeat(folder: Path, rng: np.random.Generator) -> str:
    path = _file(folder, rng)
    content = path.read_bytes()
    place = int(rng.integers(len(content) + 1))
    path.write_bytes(content[:place] + rng.bytes(int(rng.integers(1, 64))) + content[place:])
    return path.name


def remove(folder: Path, rng: np.random.Generator) -> str:
    path = _file(folder, rng)
    path.unlink(missing_ok=True)
    return path.name


def change_json_field(folder: Path, rng: np.random.Generator) -> str:
    path = folder / ("names.json" if rng.random() < 0.2 else "camera.json")
    try:
        content = json.loads(path.read_text())
        key = str(rng.choice(list(content)))
    except (OSError, ValueError, TypeError):
        return "nothing"
    value = ODD_VALUES[int(rng.integers(len(ODD_VALUES)))]
    kind = int(rng.integers(4))
    if kind == 0:
        content.pop(key)
    elif kind == 1 and isinstance(content[key], list):
        rows = np.array(content[key], float)
        rows[tuple(int(rng.integers(n)) for n in rows.shape)] *= float(
            rng.choice([-1, 0, 1e-6, 1.5, 1e6, np.nan])
        )
        content[key] = rows.tolist()
    elif kind == 2 and isinstance(content[key], int | float):
        content[key] = content[key] * float(rng.choice([-1, 0, 1e-4, 0.5, 10, 1e8]))
    else:
        content[key] = value
    path.write_text(json.dumps(content))
    return f"{path.name} {key} {kind} {value!r:.20}"


def change_depth(folder: Path, rng: np.random.Generator) -> str:
    depth = _image(folder / "depth.png")
    if depth is None or depth.ndim != 2:
        return "nothing"
    metres = depth.astype(np.float32) / 1000
    rows, columns = _window(depth.shape, rng)
    value = float(rng.choice([0, np.nan, np.inf, -np.inf, -1, 1e-30, 0.4, 3, 65.535, 1e30]))
    kind = int(rng.integers(5))
    if kind == 0:
        metres[rows, columns] = value
    elif kind == 1:
        metres[rng.random(depth.shape) < rng.random()] = value
    elif kind == 2:
        metres += rng.normal(0, float(rng.choice([0.002, 0.02, 0.5])), depth.shape).astype(np.float32)
    elif kind == 3:
        metres *= np.float32(rng.choice([-1, 0.001, 0.3, 3, 1000]))
    else:
        metres[:] = value
    kinds: tuple[Any, ...] = (np.float32, np.float64, np.float16, np.int32, complex, "U4", bool)
    with np.errstate(all="ignore"):
        saved = metres.astype(kinds[0] if rng.random() < 0.8 else kinds[int(rng.integers(len(kinds)))])
    np.save(folder / "depth.npy", saved)
    return f"{kind} {value} {saved.dtype}"


def change_labels(folder: Path, rng: np.random.Generator) -> str:
    labels = _image(folder / "labels.png")
    if labels is None or labels.ndim != 2:
        return "nothing"
    labels = labels.astype(np.uint16)
    rows, columns = _window(labels.shape, rng)
    kind = int(rng.integers(6))
    if kind == 0:
        labels[rows, columns] = int(rng.integers(7))
    elif kind == 1:
        labels[rng.random(labels.shape) < rng.random()] = int(rng.integers(65536))
    elif kind == 2:
        labels = np.roll(labels, rng.integers(-40, 40, 2), (0, 1))
    elif kind == 3:
        labels[rng.random(labels.shape) < 0.02] = rng.integers(65536)
    elif kind == 4:
        labels = rng.integers(0, int(rng.choice([2, 5, 300, 65536])), labels.shape).astype(np.uint16)
    else:
        labels[:] = int(rng.integers(3))
    Image.fromarray(labels).save(folder / "labels.png")
    return str(kind)


def change_shape(folder: Path, rng: np.random.Generator) -> str:
    name = str(rng.choice(["depth.png", "rgb.png", "labels.png"]))
    image = _image(folder / name)
    if image is None or 0 in image.shape:
        return "nothing"
    kind = int(rng.integers(5))
    if kind == 0:
        image = image[: max(1, int(rng.integers(image.shape[0]))), :]
    elif kind == 1:
        image = image.swapaxes(0, 1)
    elif kind == 2:
        image = np.repeat(image, 2, axis=int(rng.integers(2)))
    elif kind == 3:
        image = (image >> (8 if image.dtype == np.uint16 else 0)).astype(np.uint8)
    else:
        image = image[:1, :1]
    Image.fromarray(np.ascontiguousarray(image)).save(folder / name)
    return f"{name} {kind} {image.shape}"


def swap_files(folder: Path, rng: np.random.Generator) -> str:
    a, b = (folder / str(name) for name in rng.choice(FILES, 2, replace=False))
    if a.exists() and b.exists():
        first, second = a.read_bytes(), b.read_bytes()
        a.write_bytes(second)
        b.write_bytes(first)
    return f"{a.name} {b.name}"


MUTATIONS = (
    flip_bytes, cut, insert_or_repeat, remove, change_json_field, change_json_field, change_json_field,
    change_depth, change_depth, change_depth, change_labels, change_labels, change_labels, change_shape,
    swap_files,
)  # fmt: skip


def _file(folder: Path, rng: np.random.Generator) -> Path:
    there = sorted(path for path in folder.iterdir() if path.is_file())
    return there[int(rng.integers(len(there)))] if there else folder / "camera.json"


def _image(path: Path) -> np.ndarray | None:
    try:
        with Image.open(path) as image:
            return np.array(image)
    except (OSError, SyntaxError, ValueError):
        return None


def _window(shape: tuple[int, ...], rng: np.random.Generator) -> tuple[slice, slice]:
    (a, b), (c, d) = (sorted(rng.integers(0, n + 1, 2).tolist()) for n in shape[:2])
    return slice(a, b), slice(c, d)
