"""Files from anywhere, read within limits: plain JSON and NumPy files, and one clear line for all else.

Knows files only; it knows nothing of what their content means.
"""

from __future__ import annotations

import json
import os
import stat
import tokenize
import zipfile
import zlib
from collections.abc import Callable, Collection
from pathlib import Path
from typing import IO, Any, NoReturn

import numpy as np

from mapping.errors import DataError

LARGEST_JSON = 32 * 2**20
"""Bytes of the largest JSON file that is read."""
LARGEST_ARRAY = 2**28
"""Bytes of the largest array that is unpacked."""
LARGEST_INTEGER = 2**63
"""Whole numbers from here on fit no array."""
METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""How numpy.savez packs its arrays."""
ENCRYPTED = 1
"""The bit of a zip member's flags that says so."""

# What Python's and NumPy's readers raise on files that are not what they say: a damaged header is parsed as
# Python source, an encrypted member is a RuntimeError, an unknown packing a NotImplementedError.
BROKEN = (
    ValueError,
    OSError,
    EOFError,
    KeyError,
    TypeError,
    SyntaxError,
    IndexError,
    AttributeError,
    OverflowError,
    RuntimeError,
    MemoryError,
    tokenize.TokenError,
    zipfile.BadZipFile,
    zlib.error,
)


def check_plain(path: Path, hint: str = "", error: type[DataError] = DataError) -> int:
    """The size of a file [bytes]; raises `error` when it is missing, a folder, a pipe or a device.

    Reading from a pipe that nobody writes to never ends. hint: how to mend a missing file.
    """
    try:
        found = os.stat(path)
    except FileNotFoundError as missing:
        raise error(f"{path}: no such file{_and(hint)}") from missing
    except (OSError, ValueError) as wrong:
        raise error(f"{path}: cannot be read ({line(wrong)}){_and(hint)}") from wrong
    if stat.S_ISDIR(found.st_mode):
        raise error(f"{path}: is a folder, not a file{_and(hint)}")
    if not stat.S_ISREG(found.st_mode):
        raise error(f"{path}: is a pipe or device, not a plain file; copy its content to a file")
    return found.st_size


def read_json(
    path: Path, hint: str = "", error: type[DataError] = DataError, largest: int = LARGEST_JSON
) -> Any:
    """The content of a JSON file. Raises `error` for a file that is missing, too large, no JSON, nested too
    deep, or holds whole numbers that no array can."""
    size = check_plain(path, hint, error)
    if size > largest:
        raise error(f"{path}: {size >> 20} MB of JSON, more than {largest >> 20} MB; is it the right file?")
    try:
        return parse_json(path.read_bytes().decode("utf-8-sig"))
    except RecursionError as deep:
        raise error(f"{path}: nested too deep for a file of settings{_and(hint)}") from deep
    except BROKEN as wrong:
        raise error(f"{path}: not readable as JSON ({line(wrong)}){_and(hint)}") from wrong


def parse_json(text: str) -> Any:
    """json.loads with a ValueError for whole numbers beyond 64 bits."""
    return json.loads(text, parse_int=_whole)


def read_npy(path: Path, error: type[DataError] = DataError) -> np.ndarray:
    """The array of a .npy file. Raises `error` for pickled objects and for less than its header announces."""
    size = check_plain(path, error=error)
    try:
        with path.open("rb") as file:
            wanted = _announced(file, size)
            if wanted > size:
                raise ValueError(f"{size} bytes, cut short? Its header announces {wanted}")
            file.seek(0)
            return np.lib.format.read_array(file, allow_pickle=False)
    except BROKEN as wrong:
        _refuse(path, ".npy", "numpy.save", error, wrong)


def read_npz(
    path: Path,
    wanted: Collection[str] | None = None,
    error: type[DataError] = DataError,
    largest: int = LARGEST_ARRAY,
) -> dict[str, np.ndarray]:
    """The arrays of a .npz file by name: those `wanted`, or all.

    Nothing is unpacked that is larger than `largest` bytes, encrypted, packed in a way numpy.savez does not,
    or of a name that points outside of the archive: `error` is raised, as for pickled objects.
    """
    check_plain(path, error=error)
    try:
        with zipfile.ZipFile(path) as archive:
            for name in archive.namelist():
                _check_name(name)
            members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
            return {
                name: _read_member(archive, info, largest)
                for name, info in members.items()
                if wanted is None or name in wanted
            }
    except BROKEN as wrong:
        _refuse(path, ".npz", "numpy.savez", error, wrong)


def names_of_npz(path: Path, error: type[DataError] = DataError) -> list[str]:
    """Names of the arrays in a .npz file, sorted."""
    check_plain(path, error=error)
    try:
        with zipfile.ZipFile(path) as archive:
            return sorted(name.removesuffix(".npy") for name in archive.namelist())
    except BROKEN as wrong:
        _refuse(path, ".npz", "numpy.savez", error, wrong)


def printable(text: str) -> str:
    """The text with a replacement sign for halves of surrogate pairs, which no file or console takes."""
    return text.encode("utf-8", "replace").decode("utf-8")


def line(error: BaseException) -> str:
    """The first line of an exception's text."""
    return (str(error) or type(error).__name__).splitlines()[0]


def _whole(digits: str) -> int:
    # Beyond 19 digits it is too large anyway, and thousands of digits take long to convert.
    if len(digits) > 20 or not -LARGEST_INTEGER <= int(digits) < LARGEST_INTEGER:
        raise ValueError(f"a whole number of {len(digits)} digits")
    return int(digits)


def _check_name(name: str) -> None:
    parts = name.replace("\\", "/").split("/")
    if ".." in parts or parts[0] in ("", ".") or ":" in parts[0]:
        raise ValueError(f"refused, its member {name!r} points outside the archive")


def _read_member(archive: zipfile.ZipFile, info: zipfile.ZipInfo, largest: int) -> np.ndarray:
    if info.flag_bits & ENCRYPTED:
        raise ValueError(f"its member {info.filename!r} is encrypted")
    if info.compress_type not in METHODS:
        raise ValueError(f"its member {info.filename!r} is packed in a way that numpy.savez does not")
    if info.file_size > largest:
        raise ValueError(f"its member {info.filename!r} unpacks to {info.file_size >> 20} MB")
    with archive.open(info) as file:
        wanted = _announced(file, info.file_size)
    if wanted > info.file_size:
        raise ValueError(f"{info.filename!r} holds {info.file_size} bytes, its header announces {wanted}")
    with archive.open(info) as file:
        return np.lib.format.read_array(file, allow_pickle=False)


def _announced(file: IO[bytes], size: int) -> int:
    """Bytes that the header of an array announces; NumPy would reserve them before it reads."""
    version = np.lib.format.read_magic(file)
    readers: dict[tuple[int, int], Callable[[Any], Any]] = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }
    if version not in readers:
        raise ValueError(f"version {version} of NumPy's format")
    shape, _, kind = readers[version](file)
    if kind.hasobject:
        raise ValueError("refused, it holds pickled objects, which can run code")
    count = 1
    for length in shape:
        if length < 0:
            raise ValueError(f"a shape of {shape}")
        count *= length
    return count * kind.itemsize


def _refuse(path: Path, kind: str, maker: str, error: type[DataError], wrong: BaseException) -> NoReturn:
    raise error(f"{path}: not a readable {kind} file ({line(wrong)}); save it again with {maker}") from wrong


def _and(hint: str) -> str:
    return f"; {hint}" if hint else ""
