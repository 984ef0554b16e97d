"""`contramap fetch ycb` against a local HTTP server that can cut connections and serve bad archives."""

from __future__ import annotations

import io
import json
import tarfile
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mapping.errors import DataError
from sim_scenes.objects import fetch, ycb

MODEL = "003_cracker_box"
NAME = f"{MODEL}_google_16k.tgz"


class Host(ThreadingHTTPServer):
    """Serves `files`; cuts the next answers after as many bytes as `cuts` says; logs Range headers."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.files: dict[str, bytes] = {}
        self.cuts: list[int] = []
        self.ranges: list[str | None] = []
        self.ignore_range = False

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}/google"


class Handler(BaseHTTPRequestHandler):
    server: Any

    def do_GET(self) -> None:
        host = self.server
        content = host.files.get(self.path.rsplit("/", 1)[-1])
        asked = self.headers.get("Range")
        host.ranges.append(asked)
        if content is None:
            self.send_error(404)
            return
        start = int(asked.split("=")[1].rstrip("-")) if asked and not host.ignore_range else 0
        if start >= len(content):
            self.send_error(416)
            return
        self.send_response(206 if start else 200)
        self.send_header("Content-Length", str(len(content) - start))
        self.end_headers()
        body = content[start:]
        if host.cuts:
            body = body[: host.cuts.pop(0)]
            self.close_connection = True
        self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        pass


@pytest.fixture
def host() -> Iterator[Host]:
    with Host() as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield server
        server.shutdown()


def archive(*extra: tuple[tarfile.TarInfo, bytes], model_id: str = MODEL) -> bytes:
    stream = io.BytesIO()
    noise = np.random.default_rng(0).bytes(200_000)  # does not compress, so that a cut falls inside
    with tarfile.open(fileobj=stream, mode="w:gz") as tar:
        for name, content in (("textured.obj", b"v 0 0 0\n"), ("texture_map.png", noise)):
            member = tarfile.TarInfo(f"{model_id}/google_16k/{name}")
            member.size = len(content)
            tar.addfile(member, io.BytesIO(content))
        for member, content in extra:
            member.size = len(content)
            tar.addfile(member, io.BytesIO(content))
    return stream.getvalue()


def get(host: Host, to: Path) -> Path:
    return fetch.fetch_ycb(to, [MODEL], base_url=host.url, progress=False)


def test_fetched_scans_are_found(host: Host, tmp_path: Path) -> None:
    host.files[NAME] = archive()
    folder = get(host, tmp_path / "ycb")
    assert ycb.list_models(folder) == [MODEL]
    assert ycb.find_ycb(folder) == folder
    assert sorted(path.name for path in folder.iterdir()) == [MODEL, fetch.CHECKSUM_FILE]


def test_what_is_there_is_not_fetched_again(host: Host, tmp_path: Path) -> None:
    host.files[NAME] = archive()
    get(host, tmp_path)
    get(host, tmp_path)
    assert len(host.ranges) == 1


def test_a_cut_connection_is_resumed_where_it_stopped(host: Host, tmp_path: Path) -> None:
    host.files[NAME] = archive()
    host.cuts = [70_000, 50_000]
    folder = get(host, tmp_path)
    assert host.ranges == [None, "bytes=70000-", "bytes=120000-"]
    picture = (folder / MODEL / "google_16k/texture_map.png").read_bytes()
    assert picture == np.random.default_rng(0).bytes(200_000)


def test_a_stopped_run_is_resumed_by_the_next(host: Host, tmp_path: Path) -> None:
    host.files[NAME] = archive()
    host.cuts = [40_000] + [0] * (fetch.ATTEMPTS - 1)
    with pytest.raises(DataError, match="run the command again"):
        get(host, tmp_path)
    assert not (tmp_path / MODEL).exists()
    get(host, tmp_path)
    assert host.ranges[-1] == "bytes=40000-"
    assert ycb.list_models(tmp_path) == [MODEL]


def test_a_server_without_ranges_starts_over(host: Host, tmp_path: Path) -> None:
    host.files[NAME] = archive()
    host.ignore_range = True
    host.cuts = [70_000]
    get(host, tmp_path)
    assert ycb.list_models(tmp_path) == [MODEL]


def test_a_part_longer_than_the_file_is_dropped(host: Host, tmp_path: Path) -> None:
    host.files[NAME] = archive()
    (tmp_path / f"{NAME}.part").write_bytes(b"x" * 1_000_000)
    get(host, tmp_path)
    assert ycb.list_models(tmp_path) == [MODEL]


def test_a_changed_archive_is_refused(host: Host, tmp_path: Path) -> None:
    host.files[NAME] = archive()
    get(host, tmp_path)
    recorded = json.loads((tmp_path / fetch.CHECKSUM_FILE).read_text())
    assert set(recorded) == {NAME}
    (tmp_path / MODEL / ycb.MESH_FILE).unlink()
    get(host, tmp_path)  # the same archive again is welcome
    (tmp_path / MODEL / ycb.MESH_FILE).unlink()
    host.files[NAME] = archive((tarfile.TarInfo(f"{MODEL}/google_16k/more.txt"), b"more"))
    with pytest.raises(DataError, match="checksum"):
        get(host, tmp_path)
    assert not (tmp_path / MODEL / ycb.MESH_FILE).exists()


def link(kind: bytes, name: str, target: str) -> tarfile.TarInfo:
    member = tarfile.TarInfo(name)
    member.type, member.linkname = kind, target
    return member


@pytest.mark.parametrize(
    "member",
    [
        tarfile.TarInfo(f"{MODEL}/../../escaped.txt"),
        tarfile.TarInfo("/tmp/escaped.txt"),
        tarfile.TarInfo("004_sugar_box/google_16k/textured.obj"),
        link(tarfile.SYMTYPE, f"{MODEL}/link", "/etc/passwd"),
        link(tarfile.LNKTYPE, f"{MODEL}/link", "../other"),
        link(tarfile.CHRTYPE, f"{MODEL}/device", ""),
    ],
    ids=["parent", "absolute", "other object", "symlink", "hard link", "device"],
)
def test_archives_that_reach_outside_are_refused(host: Host, tmp_path: Path, member: tarfile.TarInfo) -> None:
    host.files[NAME] = archive((member, b""))
    target = tmp_path / "deep" / "ycb"
    with pytest.raises(DataError, match="refused"):
        get(host, target)
    assert not (target / MODEL).exists()
    assert not list(tmp_path.rglob("escaped.txt"))
    assert not list(target.glob(".*"))  # no half-unpacked folder stays


def test_a_broken_archive_is_an_error(host: Host, tmp_path: Path) -> None:
    host.files[NAME] = b"this is no archive"
    with pytest.raises(DataError, match="readable archive"):
        get(host, tmp_path)
    assert not (tmp_path / MODEL).exists()


def test_a_truncated_archive_is_an_error(host: Host, tmp_path: Path) -> None:
    host.files[NAME] = archive()[:100_000]
    with pytest.raises(DataError, match="readable archive"):
        get(host, tmp_path)


def test_an_unknown_object_is_an_error(host: Host, tmp_path: Path) -> None:
    with pytest.raises(DataError, match="404"):
        fetch.fetch_ycb(tmp_path, ["999_unknown"], base_url=host.url, progress=False)
    with pytest.raises(DataError, match="no YCB ID"):
        fetch.fetch_ycb(tmp_path, ["../escape"], base_url=host.url, progress=False)


def test_other_scans_of_the_same_thing_are_kept(host: Host, tmp_path: Path) -> None:
    host.files[NAME] = archive()
    mine = tmp_path / MODEL / "poisson" / "textured.obj"
    mine.parent.mkdir(parents=True)
    mine.write_text("mine")
    with pytest.raises(DataError, match="poisson"):
        get(host, tmp_path)
    assert mine.read_text() == "mine"
    assert host.ranges == []  # said before the download


def test_what_killed_runs_left_is_removed(host: Host, tmp_path: Path) -> None:
    host.files[NAME] = archive()
    for name in (MODEL, NAME):
        left = tmp_path / f".{name}.0123456789ab.part"
        left.mkdir()
        (left / "half").touch()
    get(host, tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == [MODEL, fetch.CHECKSUM_FILE]
    # Also when the kill came after the scan was in place.
    (tmp_path / f".{NAME}.0123456789ab.part").mkdir()
    get(host, tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == [MODEL, fetch.CHECKSUM_FILE]


def test_a_member_that_grows_after_unpacking_is_refused(host: Host, tmp_path: Path) -> None:
    """A sparse file of 8 GB takes a few hundred bytes of the archive."""
    sparse = tarfile.TarInfo(f"{MODEL}/google_16k/zeros.bin")
    sparse.pax_headers = {
        "GNU.sparse.major": "0", "GNU.sparse.minor": "1", "GNU.sparse.map": "0,0",
        "GNU.sparse.numblocks": "1", "GNU.sparse.size": str(8 << 30),
    }  # fmt: skip
    host.files[NAME] = archive((sparse, b""))
    with pytest.raises(DataError, match="unpacks to more"):
        get(host, tmp_path)
    assert not (tmp_path / MODEL).exists()


def test_the_address_can_come_from_the_environment(
    host: Host, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    host.files[NAME] = archive()
    monkeypatch.setenv("CONTRAMAP_YCB_URL", host.url + "/")
    monkeypatch.setenv("CONTRAMAP_CACHE", str(tmp_path))
    assert fetch.fetch_ycb(only=[MODEL], progress=False) == tmp_path / "ycb"
    assert ycb.list_models(tmp_path / "ycb") == [MODEL]
