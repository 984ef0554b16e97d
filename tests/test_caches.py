"""Caches verify what they read and make again what is broken; what is refused is not kept."""

from __future__ import annotations

import gzip
import subprocess
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from solids import reconstructed_tabletop

from mapping.errors import DataError
from reconstruction.scene import beyond_its_mesh
from reconstruction.surface.closed_solid import ClosedSolid
from reconstruction.surface.parts import label, parts_to_keep
from sim_scenes import convex_parts
from sim_scenes.convex_parts import collision_file, is_whole
from sim_scenes.objects import fetch
from sim_scenes.objects.object_model import ObjectModel

MODEL = "003_cracker_box"


def model_of(mesh: trimesh.Trimesh) -> ObjectModel:
    return ObjectModel("thing", "test", mesh)


@pytest.fixture
def cache(tmp_path: Path, monkeypatch) -> Path:
    monkeypatch.setenv("CONTRAMAP_CACHE", str(tmp_path))
    return tmp_path / "convex_parts"


@pytest.mark.parametrize("damage", ["", "cut", "nan", "inf", "text", "binary"])
def test_a_broken_collision_shape_is_made_again(cache: Path, damage: str) -> None:
    model = model_of(trimesh.creation.box((0.1, 0.1, 0.1)))
    path = collision_file(model)
    good = path.read_text()
    assert is_whole(path)
    first = good.index("v ") + 2
    broken = {
        "": "",
        "cut": good[: len(good) // 2],
        "nan": good[:first] + "nan" + good[good.index(" ", first) :],
        "inf": good[:first] + "1e999" + good[good.index(" ", first) :],
        "text": good[:first] + "x" + good[good.index(" ", first) :],
        "binary": "\x00\xff" * 50,
    }[damage]
    path.write_text(broken)
    assert not is_whole(path)
    assert collision_file(model) == path
    assert path.read_text() == good
    assert [entry.name for entry in cache.iterdir()] == [path.name]


@pytest.mark.parametrize("end", [-9, -15, "timeout"])
def test_a_killed_helper_leaves_no_other_shape_under_the_same_name(cache: Path, monkeypatch, end) -> None:
    """Its hull in place of the parts would make another scene of the same seed."""
    ring = trimesh.creation.torus(0.1, 0.02, major_sections=16, minor_sections=8)

    def run(command, **options):
        if end == "timeout":
            raise subprocess.TimeoutExpired(command, 1)
        return SimpleNamespace(returncode=end, stderr="")

    monkeypatch.setattr(convex_parts.subprocess, "run", run)
    with pytest.raises(DataError, match="try again"):
        collision_file(model_of(ring))
    assert not cache.exists() or not list(cache.iterdir())


def test_a_mesh_with_nan_is_refused_in_words(tmp_path: Path) -> None:
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    vertices = np.array(box.vertices)
    vertices[0] = np.nan
    with pytest.raises(DataError, match="NaN"):
        convex_parts._decompose(
            trimesh.Trimesh(vertices, box.faces, process=False), convex_parts.ConvexConfig(), tmp_path
        )


def archive_of(size: int = 100_000) -> bytes:
    import io
    import tarfile

    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w:gz") as tar:
        info = tarfile.TarInfo(f"{MODEL}/{fetch.MESH_FILE}")
        info.size = size
        tar.addfile(info, io.BytesIO(np.random.default_rng(0).bytes(size)))
    return buffer.getvalue()


@pytest.mark.parametrize("damage", ["cut trailer", "wrong checksum", "bomb", "cut"])
def test_archives_are_read_to_their_end(tmp_path: Path, damage: str, monkeypatch) -> None:
    content = archive_of()
    if damage == "cut trailer":
        content = content[:-6]
    elif damage == "cut":
        content = content[: len(content) // 2]
    elif damage == "wrong checksum":
        content = content[:-8] + bytes(4) + content[-4:]
    else:
        monkeypatch.setattr(fetch, "LARGEST_UNPACKED", 1 << 20)
        content = gzip.compress(bytes(4 << 20))
    path = tmp_path / "a.tgz"
    path.write_bytes(content)
    with pytest.raises(DataError):
        fetch.extract(path, tmp_path, MODEL)
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.tgz"]


@pytest.mark.parametrize("answer", ["garbage", "cut without length", "damaged", "half a header"])
def test_bad_answers_leave_nothing_and_the_right_archive_is_taken_later(tmp_path: Path, answer: str) -> None:
    import socketserver
    import threading

    good = archive_of()
    head = b"HTTP/1.0 200 OK\r\n\r\n"
    bad = {
        "garbage": b"\x00\x01nonsense\r\n\r\n",
        "cut without length": head + good[:-4],
        "damaged": head + good[:5000] + bytes(9) + good[5009:],
        "half a header": b"HTTP/1.1 200 OK\r\nContent-Length: many\r\n\r\n",
    }[answer]
    answers = [bad]

    class Handler(socketserver.BaseRequestHandler):
        def handle(self) -> None:
            self.request.recv(4096)
            self.request.sendall(answers[0])

    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        url = f"http://127.0.0.1:{server.server_address[1]}"
        with pytest.raises(DataError):
            fetch.fetch_ycb(tmp_path / "ycb", [MODEL], url, progress=False)
        left = [entry.name for entry in (tmp_path / "ycb").iterdir()]
        assert not [name for name in left if not name.endswith(".part")]
        answers[0] = head + good
        fetch.fetch_ycb(tmp_path / "ycb", [MODEL], url, progress=False)
        server.shutdown()
    assert sorted(entry.name for entry in (tmp_path / "ycb").iterdir()) == [MODEL, fetch.CHECKSUM_FILE]


@pytest.mark.parametrize(
    ("limit", "value", "said"), [("LONGEST_S", 0.2, "not done"), ("LARGEST_ARCHIVE", 50, "never ends")]
)
def test_servers_that_trickle_or_never_end(
    tmp_path: Path, monkeypatch, limit: str, value: float, said: str
) -> None:
    """A byte at a time, without a length: given up after a while, or when it is more than any archive."""
    import socketserver
    import threading
    import time

    class Handler(socketserver.BaseRequestHandler):
        def handle(self) -> None:
            self.request.recv(4096)
            try:
                self.request.sendall(b"HTTP/1.0 200 OK\r\n\r\n")
                for _ in range(200):
                    self.request.sendall(b"x")
                    time.sleep(0.01)
            except OSError:
                return

    monkeypatch.setattr(fetch, limit, value)
    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Handler) as server:
        server.daemon_threads = True
        threading.Thread(target=server.serve_forever, daemon=True).start()
        url = f"http://127.0.0.1:{server.server_address[1]}"
        with pytest.raises(DataError, match=said):
            fetch.fetch_ycb(tmp_path / "ycb", [MODEL], url, progress=False)
        server.shutdown()
    parts = [entry.name for entry in (tmp_path / "ycb").iterdir()]
    assert len(parts) == (limit == "LONGEST_S")  # gone on with later; what is refused is not kept


def test_small_parts_that_were_seen_are_delivered() -> None:
    parts = np.zeros((40, 20, 20), int)
    parts[2:14, 2:14, 2:14] = 1
    parts[20:23, 5:7, 5:7] = 2  # seen
    parts[30:33, 5:7, 5:7] = 3  # not seen
    parts[36, 5, 5] = 4  # a stray point
    found = label(np.where(parts > 0, 1, -1).astype(np.float32))
    seen = np.concatenate([np.tile([21, 5, 5], (30, 1)), [[36, 5, 5]], [[500, 0, 0]], [[-3, 1, 1]]])
    assert parts_to_keep(found, parts.shape, 0.05, seen).tolist() == [1, 2]
    assert parts_to_keep(found, parts.shape, 0.05, None).tolist() == [1]
    assert parts_to_keep(found, parts.shape, 0.0, None).tolist() == [1, 2, 3, 4]


@pytest.mark.parametrize(("points", "there"), [(40, True), (0, False)])
def test_a_small_part_of_an_object_is_in_its_mesh_when_it_was_seen(points: int, there: bool) -> None:
    nodes = np.indices((40, 20, 20)).transpose(1, 2, 3, 0)
    large = 8.0 - np.linalg.norm(nodes - (10, 10, 10), axis=-1)
    small = 2.0 - np.linalg.norm(nodes - (32, 10, 10), axis=-1)  # 1.6 % of the large part
    seen = np.concatenate([np.tile([3, 10, 10], (100, 1)), np.tile([31, 9, 9], (points, 1))])
    found = ClosedSolid.of(np.maximum(large, small).astype(np.float32), 0.05, seen)
    assert found is not None
    mesh = trimesh.Trimesh(*found.surface(), process=False)
    assert mesh.is_watertight
    assert (mesh.bounds[1, 0] > 30) == there


def test_what_was_measured_beyond_a_mesh_is_said() -> None:
    item = reconstructed_tabletop().observation.objects[0]
    low, high = item.points.min(0), item.points.max(0)
    corners = np.stack([low, high])
    assert beyond_its_mesh(item, corners) == []
    cut = np.stack([low, [*high[:2], high[2] - 0.05]])
    (line,) = beyond_its_mesh(item, cut)
    assert item.name in line
    assert "50 mm beyond" in line
