"""`contramap semantic`: files, tiles against one tile, workers that die, resuming, bad input."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_multiscale import street

from mapping.errors import DataError
from tools.cli import main
from tools.semantic import workers
from tools.semantic.command import map_scans
from tools.semantic.tiles import NOTHING, Job, plan_tiles

zarr = pytest.importorskip("zarr")
NAMES = np.array(["road", "building", "pole"])


@pytest.fixture(scope="module")
def scans(tmp_path_factory) -> tuple[Path, ...]:
    """Two labelled clouds of a street."""
    folder = tmp_path_factory.mktemp("scans")
    paths = []
    for number in range(2):
        X, y = street(1500, seed=number)
        np.savez(folder / f"{number}.npz", points=X, labels=y, names=NAMES)
        paths.append(folder / f"{number}.npz")
    return tuple(paths)


@pytest.fixture(scope="module")
def tiled(scans, tmp_path_factory) -> Path:
    """The street mapped by the command in two tiles, with every kind of output."""
    out = tmp_path_factory.mktemp("tiled") / "out"
    query = out.parent / "points.npy"
    np.save(query, np.array([[3.0, 0.0, 0.0], [3.0, 4.0, 1.5], [3.0, 0.0, 15.0]]))
    arguments = ["semantic", *map(str, scans), "--out", str(out), "--tile", "8", "--overlap", "5"]
    arguments += ["--query", str(query), "--json", str(out.parent / "figures.json")]
    assert main(arguments) == 0
    return out


def chunks(out: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(out)): path.read_bytes()
        for path in sorted((out / "voxels.zarr").rglob("*"))
        if path.is_file()
    }


def test_voxels_queries_cloud_and_picture_show_the_street(tiled):
    store = zarr.open_group(tiled / "voxels.zarr", mode="r")
    origin, voxel = np.array(store.attrs["origin_m"]), store.attrs["voxel_m"]
    X, y = street(300, seed=5)
    cell = tuple(((X - origin) / voxel).astype(int).T)
    label = store["label"][:][cell]
    assert (label == y).mean() > 0.9
    assert (store["uncertain"][:][cell] < 0.5).mean() > 0.9
    assert store["label"][:][0, 0, 0] == NOTHING
    with np.load(tiled / "query.npz") as answer:
        p = answer["probabilities"]
        assert list(answer["classes"]) == [*NAMES, "uncertain"]
        assert answer["label"].tolist()[:2] == [0, 1]
        assert answer["doubt"][:2].max() < 0.5
    assert p[:2].argmax(1).tolist() == [0, 1]
    assert p[2].argmax() == 3
    figures = json.loads((tiled.parent / "figures.json").read_text())
    assert figures["tiles"] == 2 * 2
    assert figures["points"] == 2 * 3075
    assert (tiled / "map.png").stat().st_size > 100
    trimesh = pytest.importorskip("trimesh")
    cloud = trimesh.load(tiled / "cloud.ply")
    assert len(cloud.vertices) > 500
    assert cloud.bounds[0, 2] > -1
    doubt = store["doubt"][:]
    assert np.median(doubt[cell]) < 0.1
    assert (doubt[store["label"][:] == NOTHING] == 1).all()
    vertices = cloud.metadata["_ply_raw"]["vertex"]["data"]
    assert 0 <= vertices["doubt"].min() < vertices["doubt"].max() <= 1
    assert vertices["uncertain"].max() <= 0.5


def test_one_tile_and_many_agree(scans, tiled, tmp_path):
    figures = map_scans(scans, tmp_path / "one", tile=100.0, overlap=5.0)
    assert figures["tiles"] == 1
    one, many = (zarr.open_group(folder / "voxels.zarr", mode="r") for folder in (tmp_path / "one", tiled))
    first, second = one["label"][:], many["label"][:]
    assert first.shape == second.shape
    assert ((first != NOTHING) == (second != NOTHING)).all()
    near = first != NOTHING
    sure = near & (one["uncertain"][:] < 0.5)
    assert (first[sure] == second[sure]).mean() > 0.995
    assert np.abs(one["uncertain"][:][near].astype(float) - many["uncertain"][:][near]).mean() < 0.005


def test_a_run_goes_on_where_it_stopped_and_mends_half_a_chunk(scans, tiled):
    before = chunks(tiled)
    tile = next((tiled / "tiles").glob("*.done"))
    fitted = {path: path.stat().st_mtime_ns for path in (tiled / "tiles").glob("*.npz")}
    tile.unlink()
    name = next(name for name in before if "/c/" in name and name.startswith("voxels.zarr/label"))
    (tiled / name).write_bytes(before[name][: len(before[name]) // 2])
    for done in (tiled / "tiles").glob("*.done"):
        done.unlink()
    map_scans(scans, tiled, tile=8.0, overlap=5.0)
    assert chunks(tiled) == before
    assert {path: path.stat().st_mtime_ns for path in fitted} == fitted


def test_another_run_in_the_same_folder_is_refused(scans, tiled, capsys):
    arguments = ["semantic", str(scans[0]), "--out", str(tiled)]
    assert main(arguments) == 2
    assert "--overwrite" in capsys.readouterr().err


@pytest.mark.parametrize("known", [None, "{", "[]", "{}"])
def test_tiles_of_others_are_kept(scans, tmp_path, capsys, known):
    (tmp_path / "tiles").mkdir()
    (tmp_path / "tiles" / "14_8761_5713.png").write_text("a street")
    if known is not None:
        (tmp_path / "run.json").write_text(known)
    assert main(["semantic", str(scans[0]), "--out", str(tmp_path), "--overwrite"]) == 2
    assert "another --out" in capsys.readouterr().err
    assert (tmp_path / "tiles" / "14_8761_5713.png").read_text() == "a street"


def dying_task(job: Job, tile: tuple[int, int]) -> None:
    """Kills its worker the first time."""
    marker = job.folder / f"{tile[0]}_{tile[1]}"
    if not (job.folder / "died").exists():
        (job.folder / "died").touch()
        os._exit(9)
    marker.write_text("done")


def always_dying(job: Job, tile: tuple[int, int]) -> None:
    """Kills its worker every time."""
    os._exit(9)


def test_a_worker_that_dies_costs_a_retry(tmp_path):
    job = Job(tmp_path, None, None, None, 0)  # type: ignore[arg-type]
    finished: list[int] = []
    workers.run_tasks(dying_task, job, [(0, 0), (0, 1)], 2, "local", lambda: finished.append(1))
    assert len(finished) == 2
    assert (tmp_path / "0_0").exists()
    assert (tmp_path / "0_1").exists()


@pytest.mark.slow
def test_workers_that_keep_dying_are_one_clear_error(tmp_path):
    job = Job(tmp_path, None, None, None, 0)  # type: ignore[arg-type]
    with pytest.raises(DataError, match="workers died"):
        workers.run_tasks(always_dying, job, [(0, 0)], 2, "local", lambda: None)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["local", "ray"])
def test_the_bytes_do_not_depend_on_the_workers(scans, tiled, tmp_path, engine):
    if engine == "ray":
        pytest.importorskip("ray")
    before = chunks(tiled)
    map_scans(scans, tmp_path / "out", tile=8.0, overlap=5.0, workers=2, engine=engine)
    assert chunks(tmp_path / "out") == before


@pytest.mark.slow
def test_the_recording_grows_scan_by_scan(scans, tmp_path):
    pytest.importorskip("rerun")
    map_scans(scans, tmp_path / "out", tile=100.0, rrd=tmp_path / "a.rrd")
    assert (tmp_path / "a.rrd").stat().st_size > 10_000


def test_weights_of_tiles_sum_to_one_inside():
    X = np.random.default_rng(0).uniform(0, 20, (500, 3))
    plan = plan_tiles(X, 0.5, 8.0, 2.0)
    total = sum(plan.weight(tile, X) for tile in plan.tiles())
    inside = (X[:, :2].min(1) > 2) & (X[:, :2].max(1) < 16)
    np.testing.assert_allclose(total[inside], 1.0, atol=1e-9)
    assert replace(plan, overlap=1.0).around((0, 0)) == [(0, 0), (0, 1), (1, 0), (1, 1)]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nothing.npz"], "no such file"),
        (["scan.npz", "--tile", "0"], "--tile must be > 0"),
        (["scan.npz", "--tolerance", "0"], "--tolerance must be > 0"),
        (["scan.npz", "--steps", "0"], "--steps must be at least 1"),
        (["scan.npz", "--query", "wrong.npy"], "wants finite points"),
        (["scan.npz", "other.npz"], "other classes"),
        (["unlabelled.npz"], "no point of these scans has a label"),
    ],
)
def test_bad_input_is_one_line(tmp_path, capsys, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    X, y = street(50)
    np.savez("scan.npz", points=X, labels=y, names=NAMES)
    np.savez("other.npz", points=X, labels=y, names=NAMES[::-1])
    np.savez("unlabelled.npz", points=X, labels=np.full(len(X), -1))
    np.save("wrong.npy", np.full((3, 3), np.nan))
    assert main(["semantic", *arguments, "--out", "out"]) == 2
    assert message in capsys.readouterr().err
    assert not Path("out").exists()
