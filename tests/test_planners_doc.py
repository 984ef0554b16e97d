"""The snippets of docs/planners.md, run as they stand on a small result."""

from __future__ import annotations

import re
import threading
from pathlib import Path

import numpy as np
import pytest
from solids import reconstructed_tabletop

from reconstruction.files.result_folder import save_reconstruction
from tools.cli import main

TEXT = (Path(__file__).resolve().parent.parent / "docs" / "planners.md").read_text()
SNIPPETS = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("doc")
    save_reconstruction(reconstructed_tabletop(), place / "result")
    command = re.search(r"contramap (export result .*)", TEXT)
    arguments = command[1].split()
    assert main([str(place / a) if a in ("result", "exports") else a for a in arguments]) == 0
    return place


@pytest.mark.slow
@pytest.mark.parametrize("index", range(len(SNIPPETS)))
def test_snippets_run(index, folder, monkeypatch):
    code = SNIPPETS[index]
    for package in ("mujoco", "pybullet", "yaml", "zmq"):
        if package in code or (package == "zmq" and "Client" in code):
            pytest.importorskip(package)
    monkeypatch.chdir(folder)
    frame = reconstructed_tabletop().frame
    given = {
        "points": np.random.default_rng(0).uniform(-0.2, 0.2, (100, 3)),
        "depth": frame.depth,
        "K": frame.camera.K,
        "labels": frame.labels,
        "T": frame.camera.T_world_camera,
    }
    if "Client" not in code:
        exec(compile(code, "docs/planners.md", "exec"), given)
        return
    from reconstruction.config import preset
    from tools.serving.answers import Answers
    from tools.serving.server import Server

    server, stop = Server(Answers(preset()), "127.0.0.1", 0, 10_000_000), threading.Event()
    thread = threading.Thread(target=server.serve, args=(stop.is_set, 20))
    thread.start()
    try:
        exec(compile(code.replace("tcp://127.0.0.1:5560", server.address), "docs/planners.md", "exec"), given)
    finally:
        stop.set()
        thread.join()
        server.close()
    assert len(given["answer"]["objects"]) == 4
    assert given["near"]["distance"].shape == (100,)


def test_every_format_is_in_the_table():
    from reconstruction.export.formats import FORMATS

    for name in FORMATS:
        assert f"`{name}`" in TEXT
