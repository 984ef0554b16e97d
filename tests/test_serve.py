"""The service: same answers as the library, from several clients, and alive after everything that is sent to
it."""

from __future__ import annotations

import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from mapping.errors import ConfigError, DataError
from reconstruction.config import preset
from reconstruction.scene import reconstruct
from tools.serving.messages import decode, encode

zmq = pytest.importorskip("zmq")
msgpack = pytest.importorskip("msgpack")

from tools.serving.answers import Answers  # noqa: E402
from tools.serving.client import Client  # noqa: E402
from tools.serving.server import Server  # noqa: E402

LARGEST = 4_000_000
CLIENT = Path(__file__).resolve().parent.parent / "tools" / "serving" / "client.py"


@pytest.fixture(scope="module")
def address():
    server = Server(Answers(preset()), "127.0.0.1", 0, LARGEST)
    stop = threading.Event()
    thread = threading.Thread(target=server.serve, args=(stop.is_set, 20))
    thread.start()
    yield server.address
    stop.set()
    thread.join()
    server.close()


@pytest.fixture
def client(address):
    found = Client(address, 60)
    yield found
    found.socket.close(0)


def parts(frame) -> dict[str, np.ndarray]:
    camera = frame.camera
    return {
        "depth": frame.depth,
        "K": camera.K,
        "labels": frame.labels,
        "T_world_camera": camera.T_world_camera,
    }


def small(frame) -> dict[str, np.ndarray]:
    """Every second pixel."""
    K = frame.camera.K.copy()
    K[:2] /= 2
    return {**parts(frame), "depth": frame.depth[::2, ::2], "labels": frame.labels[::2, ::2], "K": K}


def test_answers_say_how_far_to_trust_them(client, tabletop_frame):
    frame = small(tabletop_frame)
    plain = client.map(**frame)["objects"]
    checked = client.map(**frame, agreement=True)["objects"]
    for item, full in zip(plain, checked, strict=True):
        trust = item["trust"]
        assert 0 < trust["measured_pixels"] <= trust["labelled_pixels"]
        assert trust["support_seen"] is True
        assert trust["notes"] == []
        assert "agreement" not in trust
        assert full["trust"]["agreement"] > 0.8
        assert full["trust"]["early_rays"] < 0.05
    with pytest.raises(RuntimeError, match="agreement must be true or false"):
        client.map(**frame, agreement="yes")


def test_answers_are_the_librarys(client, tabletop_frame):
    answer = client.map(**parts(tabletop_frame), names={"1": "a box"})
    mine = reconstruct(tabletop_frame)
    assert [item["label"] for item in answer["objects"]] == [item.label for item in mine.objects]
    for item, own in zip(answer["objects"], mine.objects, strict=True):
        assert (item["vertices"] == own.mesh.vertices).all()
        assert (item["faces"] == own.mesh.faces).all()
        assert (item["uncertainty"] == own.uncertainty).all()
        assert (item["T_world_object"] == own.T_world_object).all()
    assert answer["objects"][0]["name"] in ("a box", "object_2", "object_3", "object_4")
    points = np.random.default_rng(0).uniform(-0.2, 0.2, (500, 3))
    found = client.distance(points)
    assert found["distance"] == pytest.approx(mine.distance(points).distance, abs=1e-6)
    assert found["unknown"].dtype == bool
    one = client.distance(points, label=mine.objects[0].label)
    assert np.quantile(found["distance"] - one["distance"], 0.98) < 2e-3


def test_several_clients_have_their_own_results(address, tabletop_frame):
    first, second = Client(address, 60), Client(address, 60)
    first.map(**small(tabletop_frame))
    with pytest.raises(RuntimeError, match="no mapped frame"):
        second.distance(np.zeros((1, 3)))
    moved = small(tabletop_frame)
    moved["T_world_camera"] = moved["T_world_camera"].copy()
    moved["T_world_camera"][0, 3] += 1.0
    second.map(**moved)
    here, there = (c.distance(np.array([[0.0, 0.0, 0.3]])) for c in (first, second))
    assert there["distance"][0] > here["distance"][0] + 0.3
    for one in (first, second):
        one.socket.close(0)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "not a msgpack"),
        (b"\xc1\xff\x00", "not a msgpack"),
        (b"\x93\x01\x02", "not a msgpack"),
        (msgpack.packb([1, 2]), "map with 'request'"),
        (msgpack.packb({"request": "eval"}), "unknown request 'eval'; valid: ping, map, distance"),
        (msgpack.packb({"request": ["map"]}), "unknown request"),
        (msgpack.packb({"request": "map", "code": "1"}), "unknown field 'code'"),
        (msgpack.packb({"request": "map"}), "needs depth"),
        (msgpack.packb({"request": "map", "depth": "x" * 20_000}), "not a msgpack message"),
        (b"\x81" * 100_000, "not a msgpack"),
        (msgpack.packb({"a": {"dtype": "|O", "shape": [1], "data": b"12345678"}}), "'|O' are not taken"),
        (msgpack.packb({"a": {"dtype": "<f4", "shape": [1 << 40], "data": b""}}), "does not have 0 bytes"),
        (msgpack.packb({"a": {"dtype": "<f4", "shape": [-1], "data": b""}}), "whole numbers"),
        (msgpack.packb(msgpack.ExtType(5, b"x")), "not a msgpack"),
        (b"\x00" * (LARGEST + 1), "more than the 4000000 this server takes"),
    ],
)
def test_broken_and_oversized_messages_are_answered(address, content, said):
    socket = zmq.Context.instance().socket(zmq.REQ)
    socket.setsockopt(zmq.RCVTIMEO, 20_000)
    socket.connect(address)
    socket.send(content)
    answer = msgpack.unpackb(socket.recv())
    socket.close(0)
    assert answer["ok"] is False
    assert said in answer["error"]
    other = Client(address, 20)
    assert other.ask("ping")["service"] == "contramap"
    other.socket.close(0)


def test_frames_that_cannot_be_mapped_are_answered(client, tabletop_frame):
    good = parts(tabletop_frame)
    with pytest.raises(RuntimeError, match="millimetres"):
        client.map(**{**good, "depth": (1000 * good["depth"]).astype(np.float32)})
    with pytest.raises(RuntimeError, match="must be an array"):
        client.map(**{**good, "K": "identity"})
    with pytest.raises(RuntimeError, match="seed"):
        client.map(**good, seed=-3)
    assert client.ask("ping")["ok"]


def test_killed_clients_and_far_too_large_messages_leave_the_service_up(address, tabletop_frame):
    context = zmq.Context()
    for content in (encode({"request": "map", **small(tabletop_frame)}), b"\x00" * (5 * LARGEST), b"\x90"):
        gone = context.socket(zmq.DEALER)
        gone.connect(address)
        gone.send_multipart([b"", content])
        gone.close(200)
    context.destroy(200)
    after = Client(address, 60)
    assert after.ask("ping")["ok"]
    after.socket.close(0)


def test_messages_hold_nothing_executable():
    source = (CLIENT.parent / "messages.py").read_text() + (CLIENT.parent / "server.py").read_text()
    assert "pickle" not in source
    assert "eval(" not in source
    for value in (np.array(["a"]), np.array([object()])):
        with pytest.raises(DataError):
            decode(encode({"x": {"dtype": value.dtype.str, "shape": [1], "data": b"12345678"}}), 10_000)
    content = {"x": np.arange(6, dtype=np.uint16).reshape(2, 3), "y": [np.float64(1.5)], "z": None}
    back = decode(encode(content), 10_000)
    assert (back["x"] == content["x"]).all()
    assert back["y"][0] == 1.5


def test_client_stands_alone():
    """In a process that cannot import torch or this project."""
    assert sum(bool(line.strip()) for line in CLIENT.read_text().splitlines()) <= 50
    code = (
        "import sys, importlib.abc\n"
        "class No(importlib.abc.MetaPathFinder):\n"
        "    def find_spec(self, name, path, target=None):\n"
        "        if name.split('.')[0] in ('torch', 'open3d', 'mapping', 'perception', 'reconstruction', "
        "'tools'):\n"
        "            raise ImportError(name)\n"
        "sys.meta_path.insert(0, No())\n"
        f"exec(open({str(CLIENT)!r}).read())\n"
        "Client('tcp://127.0.0.1:9')\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd="/")


def test_warming_up_maps_a_frame_and_keeps_nothing(monkeypatch):
    import tools.serving.answers as module

    answers, mapped = Answers(preset()), []
    own = module.Answers._map

    def watched(self, client, message):
        mapped.append(own(self, client, message))
        return mapped[-1]

    monkeypatch.setattr(module.Answers, "_map", watched)
    answers.warm_up()
    assert len(mapped[0]["objects"]) == 1
    with pytest.raises(DataError, match="no mapped frame"):
        answers(b"", {"request": "distance", "points": np.zeros((1, 3))})


def test_silence_is_a_timeout():
    lonely = Client("tcp://127.0.0.1:9", 0.05)
    with pytest.raises(TimeoutError):
        lonely.ask("ping")
    lonely.socket.close(0)


def test_a_taken_port_is_refused(address):
    with pytest.raises(ConfigError, match="choose another --port"):
        Server(lambda client, message: {}, "127.0.0.1", int(address.rsplit(":", 1)[1]), LARGEST)


@pytest.mark.slow
def test_memory_does_not_grow(address, client, tabletop_frame):
    import resource

    frame = small(tabletop_frame)
    for _ in range(3):
        client.map(**frame)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for _ in range(6):
        client.map(**frame)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 60_000  # kB; a frame is 1 MB


@pytest.mark.parametrize("arguments", [["--port", "99999"], ["--max-mb", "0"], ["--host", "nowhere"]])
def test_command_refuses_in_one_line(arguments, capsys):
    from tools.cli import main

    assert main(["serve", *arguments]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


@pytest.mark.parametrize("arguments", [["--frames", "3"], ["--repeat", "0"]])
def test_the_benchmark_refuses_in_one_line(arguments, tmp_path, capsys):
    from tools.cli import main

    assert main(["benchmark", "serve", "--frame", str(tmp_path), *arguments]) == 2
    assert "at least" in capsys.readouterr().err


@pytest.mark.slow
def test_the_benchmark_writes_its_tables(tabletop_frame, tmp_path):
    """A service in a process of its own, with killed clients and broken messages, survives 30 frames."""
    import json

    from perception.frame_io import save_frame
    from tools.cli import main

    save_frame(tabletop_frame, tmp_path / "frame")
    options = ["--frames", "30", "--repeat", "2", "--out", str(tmp_path / "serve.md")]
    figures = tmp_path / "figures.json"
    command = ["benchmark", "serve", "--frame", str(tmp_path / "frame"), "--json", str(figures), *options]
    assert main(command) == 0
    text = (tmp_path / "serve.md").read_text()
    assert "320x240" in text
    assert "client killed in the middle of a request" in text
    found = json.loads(figures.read_text())
    assert found["held"][-1]["frames"] == 30
    assert len(found["troubles"]) == 7
    assert all(count >= 1 for count in found["troubles"].values())
