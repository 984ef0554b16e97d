"""Files that are not what they say: one line each, in seconds and within memory."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mapping import FrameError
from mapping.errors import DataError
from mapping.guarded_files import parse_json, printable, read_json, read_npy, read_npz
from perception import Frame, load_frame, observe, save_frame


@pytest.fixture
def folder(tabletop_frame: Frame, tmp_path: Path) -> Path:
    save_frame(tabletop_frame, tmp_path / "frame")
    return tmp_path / "frame"


def bomb(path: Path, size: int) -> None:
    """A .npz whose array of zeros unpacks to `size` bytes; the file itself is a thousandth of that."""
    header = f"{{'descr': '|u1', 'fortran_order': False, 'shape': ({size},), }}"
    header += " " * (-(len(header) + 11) % 64) + "\n"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("depth.npy", "w") as file:
        file.write(b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode())
        for _ in range(size >> 20):
            file.write(bytes(1 << 20))


def encrypted(path: Path) -> None:
    np.savez(path, depth=np.ones((4, 4)))
    content = bytearray(path.read_bytes())
    content[6] |= 1
    content[content.index(b"PK\x01\x02") + 8] |= 1
    path.write_bytes(content)


def of_method(path: Path, method: int) -> None:
    np.savez(path, depth=np.ones((4, 4)))
    content = bytearray(path.read_bytes())
    content[8] = content[content.index(b"PK\x01\x02") + 10] = method
    path.write_bytes(content)


def cut(path: Path) -> None:
    np.savez_compressed(path, depth=np.random.default_rng(0).random((40, 40)))
    path.write_bytes(path.read_bytes()[:-500])


def liar(path: Path) -> None:
    """An array whose header announces more than there is."""
    with zipfile.ZipFile(path, "w") as archive:
        header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000, 1000), }\n"
        archive.writestr("depth.npy", b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header)


def broken_header(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("depth.npy", b"\x93NUMPY\x01\x00\x10\x00" + b"{'descr': ((((( ")


@pytest.mark.parametrize(
    "make",
    [
        lambda path: bomb(path, 300 << 20),
        encrypted,
        lambda path: of_method(path, 97),
        lambda path: of_method(path, 14),
        cut,
        liar,
        broken_header,
        lambda path: path.write_bytes(b""),
        lambda path: path.mkdir(),
        os.mkfifo,
    ],
    ids=["bomb", "encrypted", "unknown_method", "lzma", "cut", "liar", "header", "empty", "folder", "pipe"],
)
def test_npz_files_that_are_not_what_they_say(tmp_path: Path, make: Callable[[Path], None]) -> None:
    path = tmp_path / "frame.npz"
    make(path)
    with pytest.raises(DataError) as caught:
        read_npz(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    with pytest.raises(FrameError):
        load_frame(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("[" * 200_000 + "]" * 200_000, "nested too deep"),
        ('{"width": 1' + "0" * 400 + "}", "401 digits"),
        ('{"width": 1' + "0" * 100_000 + "}", "100001 digits"),
        ('{"width": 36893488147419103232}', "20 digits"),
        ("{", "not readable as JSON"),
        ("\udcff", "not readable as JSON"),
        ("[]", "JSON object"),
    ],
    ids=["nested", "10**400", "10**100000", "2**65", "cut", "not_utf8", "list"],
)
def test_json_that_is_not_what_it_says(folder: Path, content: str, message: str) -> None:
    (folder / "camera.json").write_bytes(content.encode("utf-8", "surrogateescape"))
    with pytest.raises(FrameError, match=message) as caught:
        load_frame(folder)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "change",
    [
        {"K": 10**18},
        {"K": [[float("inf"), 0, 160], [0, 300, 120], [0, 0, 1]]},
        {"K": [[{}, 0, 160], [0, 300, 120], [0, 0, 1]]},
        {"depth_scale": 1e400},
        {"width": 2**62},
        {"T_world_camera": "pose"},
    ],
)
def test_absurd_values_are_frame_errors(folder: Path, change: dict) -> None:
    content = json.loads((folder / "camera.json").read_text()) | change
    (folder / "camera.json").write_text(json.dumps(content))
    with pytest.raises(FrameError):
        load_frame(folder)


@pytest.mark.parametrize("name", ["rgb.png", "depth.png", "labels.png", "camera.json", "names.json"])
def test_a_pipe_is_refused_and_not_waited_for(folder: Path, name: str) -> None:
    (folder / name).unlink()
    os.mkfifo(folder / name)
    with pytest.raises(FrameError, match="pipe"):
        load_frame(folder)


@pytest.mark.filterwarnings("ignore::PIL.Image.DecompressionBombWarning")
def test_images_too_large_to_be_unpacked_are_refused_by_their_header(folder: Path) -> None:
    Image.new("L", (20_000, 8_000)).save(folder / "labels.png")
    with pytest.raises(FrameError, match="20000x8000"):
        load_frame(folder)


def test_an_array_with_less_than_its_header_announces(tmp_path: Path) -> None:
    path = tmp_path / "depth.npy"
    np.save(path, np.ones((100, 100), np.float32))
    path.write_bytes(path.read_bytes()[:500])
    with pytest.raises(DataError, match="cut short"):
        read_npy(path)
    np.save(path, np.array([{}], object))
    with pytest.raises(DataError, match="pickled"):
        read_npy(path)


def test_good_files_are_read_as_they_are(tmp_path: Path) -> None:
    arrays = {"a": np.arange(6.0).reshape(2, 3), "b": np.array("text"), "c": np.asfortranarray(np.eye(3))}
    for save in (np.savez, np.savez_compressed):
        save(tmp_path / "x.npz", **arrays)
        found = read_npz(tmp_path / "x.npz")
        assert found.keys() == arrays.keys()
        assert all((found[name] == array).all() for name, array in arrays.items())
    assert read_npz(tmp_path / "x.npz", ["a"]).keys() == {"a"}
    (tmp_path / "x.json").write_text('{"a": [1, -9223372036854775808, 2.5, null, NaN]}')
    assert str(read_json(tmp_path / "x.json")) == "{'a': [1, -9223372036854775808, 2.5, None, nan]}"
    with pytest.raises(ValueError):
        parse_json("9223372036854775808")


def test_halves_of_surrogate_pairs_in_names(folder: Path) -> None:
    (folder / "names.json").write_text('{"1": "cup \\ud800 of tea"}')
    name = load_frame(folder).names[1]
    assert name == "cup ? of tea" == printable("cup \udfff of tea")


def test_a_console_without_letters_for_a_name_costs_nothing() -> None:
    program = "from tools.exit_code import exit_code; exit(exit_code('x', lambda: print('чашка \\ud800')))"
    environment = {**os.environ, "PYTHONIOENCODING": "ascii", "PYTHONPATH": os.pathsep.join(sys.path)}
    answer = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True)
    assert answer.returncode == 0, answer.stderr
    assert answer.stdout.startswith(b"\\u0447")


def test_too_little_memory_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    from tools.exit_code import exit_code

    def run() -> None:
        raise MemoryError("Unable to allocate 2.66 GiB")

    assert exit_code("contramap", run) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_a_mask_that_leaks_over_the_edge_and_has_no_pixel_at_the_tables_height(tabletop) -> None:
    """Eroded masks with one leak over the table's edge: pixels under the table and none at it."""
    frame = tabletop.frame
    labels = frame.labels.copy()
    table = tabletop.true_labels == 0
    height = (frame.camera.back_project(frame.depth) @ frame.camera.T_world_camera[2, :3]) + (
        frame.camera.T_world_camera[2, 3]
    )
    labels[height < 0.02] = 0
    depth = frame.depth.copy()
    row, column = np.argwhere(table & np.isfinite(depth))[0]
    depth[row : row + 3, column : column + 3] = 3.0  # the floor, far below
    labels[row : row + 3, column : column + 3] = 1
    observation = observe(Frame(depth, frame.camera, frame.rgb, labels, frame.names))
    assert {item.label for item in observation.objects} >= {1, 3}
