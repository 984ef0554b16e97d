"""Downloads YCB scans: the official archives, checked, resumed after a cut, unpacked safely."""

from __future__ import annotations

import gzip
import http.client
import json
import os
import shutil
import tarfile
import time
import urllib.error
import urllib.request
import zlib
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from mapping.errors import DataError
from mapping.files import remove_left_over, write_atomically
from mapping.folders import staged_folder, temporary_folder
from sim_scenes.objects.ycb import MESH_FILE, YCB_IDS, default_ycb_dir

BASE_URL = "http://ycb-benchmarks.s3-website-us-east-1.amazonaws.com/data/google"
"""Where the YCB project hosts its archives; $CONTRAMAP_YCB_URL or an argument overrides it."""
CHECKSUM_FILE = "checksums.json"
"""In the target folder: SHA-256 of each archive, recorded at its first download and compared later."""
ATTEMPTS = 4
"""Tries per archive; each goes on where the last one was cut."""
TIMEOUT_S = 30
LONGEST_S = 1800.0
"""Seconds after which an archive is given up for now; what came is kept for the next try."""
LARGEST_ARCHIVE = 2**29
LARGEST_UNPACKED = 2**31
"""Bytes; the largest scan's archive has 60 MB."""


def fetch_ycb(
    to: str | Path | None = None,
    only: Sequence[str] | None = None,
    base_url: str | None = None,
    progress: bool = True,
) -> Path:
    """Download and unpack scans into `to` (default: the cache folder); those already there are skipped.

    only: IDs such as 003_cracker_box (default: all). Returns the folder.
    Raises DataError when an ID is unknown to the server, the connection fails for good, an archive's checksum
    differs from the recorded one, or an archive would write outside its folder.
    """
    folder = Path(to).expanduser() if to else default_ycb_dir()
    url = (base_url or os.environ.get("CONTRAMAP_YCB_URL") or BASE_URL).rstrip("/")
    folder.mkdir(parents=True, exist_ok=True)
    for model_id in only or YCB_IDS:
        if "/" in model_id or model_id.startswith("."):
            raise DataError(f"{model_id!r} is no YCB ID; they look like 003_cracker_box")
        name = f"{model_id}_google_16k.tgz"
        remove_left_over(folder / name)  # of runs that were killed
        remove_left_over(folder / model_id)
        if (folder / model_id / MESH_FILE).is_file():
            continue
        _check_replaceable(folder / model_id)
        # Hidden, so that neither what pooch has under way nor the archive outlives a run that is killed.
        with temporary_folder(folder / name) as hidden:
            archive = _download(url, name, folder, hidden, progress)
            extract(archive, folder, model_id, partial(_remember, archive, folder))
    return folder


def _download(url: str, name: str, folder: Path, to: Path, progress: bool) -> Path:
    """The archive's path below `to` after a complete, verified download; its part lies in `folder`."""
    import pooch

    known = _checksums(folder)
    downloader = ResumingDownloader(folder, progress)
    try:
        path = pooch.retrieve(
            f"{url}/{name}",
            known_hash=known.get(name),
            fname=name,
            path=to,
            downloader=downloader,
        )
    except ValueError as error:  # pooch: the hash does not match
        raise DataError(
            f"{url}/{name}: its checksum differs from the one recorded in {folder / CHECKSUM_FILE}; the file "
            "changed or was damaged. Delete the entry there if the change is expected"
        ) from error
    return Path(path)


def _remember(archive: Path, folder: Path) -> None:
    import pooch

    known = _checksums(folder)
    known.setdefault(archive.name, pooch.file_hash(archive))
    write_atomically(folder / CHECKSUM_FILE, (json.dumps(known, indent=1, sort_keys=True) + "\n").encode())


def _checksums(folder: Path) -> dict[str, str]:
    path = folder / CHECKSUM_FILE
    try:
        return dict(json.loads(path.read_text())) if path.is_file() else {}
    except (ValueError, TypeError, RecursionError) as error:
        raise DataError(f"{path}: is not valid JSON ({error}); delete it to record checksums anew") from error


class ResumingDownloader:
    """A pooch downloader that keeps the part it got in a folder and asks only for the rest."""

    def __init__(self, folder: Path, progress: bool = True) -> None:
        self.folder, self.progress = folder, progress
        self._end = float("inf")

    def __call__(self, url: str, output_file: Any, pooch: Any) -> None:
        """Download `url` to the path `output_file`; raises DataError when it cannot be completed."""
        # pooch hands over a temporary name that differs each time; the part must outlive the process.
        part = self.folder / (url.rsplit("/", 1)[-1] + ".part")
        self._end = time.monotonic() + LONGEST_S
        problem: Exception | None = None
        for _ in range(ATTEMPTS):
            try:
                self._rest(url, part)
                shutil.move(part, output_file)
                return
            except urllib.error.HTTPError as error:
                if error.code == 416:  # the part is not a beginning of this file
                    part.unlink(missing_ok=True)
                elif error.code < 500:
                    raise DataError(f"{url}: the server answered {error.code} ({error.reason})") from error
                problem = error
            except (OSError, http.client.HTTPException, ValueError) as error:
                problem = error  # cut, or no answer of HTTP
        raise DataError(
            f"{url}: download failed after {ATTEMPTS} tries ({problem}); run the command again to go on from "
            "where it stopped"
        )

    def _rest(self, url: str, part: Path) -> None:
        from tqdm import tqdm

        have = part.stat().st_size if part.exists() else 0
        request = urllib.request.Request(url, headers={"Range": f"bytes={have}-"} if have else {})
        with urllib.request.urlopen(request, timeout=TIMEOUT_S) as answer:
            if have and answer.status != 206:  # the server sends everything again
                have = 0
            length = answer.headers.get("Content-Length")
            total = have + int(length) if length is not None else None
            if total is not None and total > LARGEST_ARCHIVE:
                raise DataError(f"{url}: {total >> 20} MB, more than any scan; is it the right address?")
            with (
                open(part, "ab" if have else "wb") as stream,
                tqdm(
                    desc=url.rsplit("/", 1)[-1],
                    initial=have,
                    total=total,
                    unit="B",
                    unit_scale=True,
                    disable=not self.progress,
                ) as bar,
            ):
                # What has come, not a whole piece: a server that trickles must not outrun the clock.
                while chunk := answer.read1(1 << 16):
                    stream.write(chunk)
                    bar.update(len(chunk))
                    if time.monotonic() > self._end:
                        raise DataError(
                            f"{url}: not done after {LONGEST_S // 60:.0f} minutes; run the command again to "
                            "go on from where it stopped"
                        )
                    if stream.tell() > LARGEST_ARCHIVE:
                        part.unlink()  # what is refused is not kept
                        raise DataError(f"{url}: never ends; is it the right address?")
        if total is not None and part.stat().st_size < total:
            raise ConnectionError(f"connection cut at {part.stat().st_size} of {total} bytes")


def extract(archive: Path, folder: Path, model_id: str, whole: Callable[[], object] = lambda: None) -> None:
    """Unpack an archive whose files all lie below `model_id`/; it appears in `folder` only when complete.

    whole: called when all is unpacked, before it appears: only what was whole is what later downloads are
    compared with. Raises DataError for members outside that folder, links, device files, and broken archives.
    """
    with staged_folder(folder / model_id, lambda: _check_replaceable(folder / model_id)) as unfinished:
        try:
            _unpack(archive, unfinished, model_id)
        except (tarfile.TarError, zlib.error, gzip.BadGzipFile, EOFError, ValueError) as error:
            raise DataError(f"{archive}: is not a readable archive ({error}); fetch it again") from error
        if not (unfinished / MESH_FILE).is_file():
            raise DataError(f"{archive}: holds no {model_id}/{MESH_FILE}")
        whole()


def _check_replaceable(scan: Path) -> None:
    """Raise DataError when a folder holds what is not of the archive, such as other scans of the thing."""
    held = sorted(entry.name for entry in scan.iterdir()) if scan.is_dir() else []
    foreign = [name for name in held if name != Path(MESH_FILE).parts[0]]
    if foreign:
        raise DataError(
            f"{scan} holds {foreign[0]}, which is not of the scan and would be lost; choose another --to"
        )


def _unpack(archive: Path, to: Path, model_id: str) -> None:
    """What lies below `model_id`/ in the archive, into the folder `to`."""
    _check_whole(archive)
    with tarfile.open(archive) as tar:
        members = tar.getmembers()
        for member in members:
            _check_member(member, archive, model_id)
        _check_size(sum(member.size for member in members), archive)  # sparse ones grow after gzip
        for member in members:
            if not Path(member.name).parts:
                continue  # the folder "." itself
            target = to / Path(member.name).relative_to(model_id)
            if member.isdir():
                target.mkdir(parents=True, exist_ok=True)
                continue
            target.parent.mkdir(parents=True, exist_ok=True)
            source = tar.extractfile(member)
            assert source is not None, "only plain files pass the check"
            with source, open(target, "wb") as stream:
                shutil.copyfileobj(source, stream)


def _check_whole(archive: Path) -> None:
    """Read an archive to its very end, where its length and checksum stand: tar stops before."""
    size = 0
    with gzip.open(archive) as stream:
        while block := stream.read(1 << 20):
            size += len(block)
            _check_size(size, archive)


def _check_size(size: int, archive: Path) -> None:
    if size > LARGEST_UNPACKED:
        raise DataError(f"{archive}: unpacks to more than {LARGEST_UNPACKED >> 20} MB; it is refused")


def _check_member(member: tarfile.TarInfo, archive: Path, model_id: str) -> None:
    parts = Path(member.name).parts
    parts = parts[1:] if parts and parts[0] == "." else parts
    if Path(member.name).is_absolute() or ".." in parts or (parts and parts[0] != model_id):
        raise DataError(f"{archive}: member {member.name!r} lies outside {model_id}/; the archive is refused")
    if not (member.isfile() or member.isdir()):
        raise DataError(f"{archive}: member {member.name!r} is a link or device; the archive is refused")
