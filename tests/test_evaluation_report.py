"""report.html: every section that has something to say, names of missing objects, every method's pictures."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from test_evaluation_summary import result

from tools.evaluation.gallery import COLUMNS, write_gallery
from tools.evaluation.report import write_report
from tools.evaluation.summary import summarise

ODD = "<b>mug</b> & 杯"


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("report")
    results = [
        result(method, f"scene_{scene}", seed, {"box": 0.8, ODD: 0.0 if method == "tsdf" else 0.6})
        for method in ("contramap", "tsdf")
        for scene in range(2)
        for seed in (0, 1)
    ]
    picture = folder / "iou.png"
    Image.new("RGB", (4, 4)).save(picture)
    failure = {"scene": "scene_0", "seed": "0", "method": "hilbert", "error": "<worker> died"}
    summary = {**summarise(results), "threads": 1, "failures": [failure]}
    write_report(summary, {"IoU": picture, "Chamfer": picture}, picture, folder / "report.html")
    return (folder / "report.html").read_text(encoding="utf-8")


def test_missing_objects_are_named_with_scene_method_and_seeds(page: str) -> None:
    section = page[page.index("Missing objects") : page.index("Uncertainty")]
    rows = re.findall(r"<tr>(.*?)</tr>", section, re.S)[1:]
    cells = [re.findall(r"<td>(.*?)</td>", row, re.S) for row in rows]
    name = "2 &lt;b&gt;mug&lt;/b&gt; &amp; 杯"
    assert cells == [[name, f"scene_{scene}", "tsdf", "0, 1", "0, 1"] for scene in range(2)]


def test_the_page_stands_alone_and_takes_no_name_for_markup(page: str) -> None:
    assert page.count("data:image/png;base64,") == 3
    assert 'src="http' not in page
    assert "<b>mug" not in page
    assert "&lt;worker&gt; died" in page
    assert "Against V-PRISM" not in page  # nothing to say


def test_spreads_stand_below_their_means_so_that_tables_are_narrow(page: str) -> None:
    assert len(re.findall(r"<td>\d\.\d+ <small>± \d\.\d+", page)) > 4


def test_the_gallery_has_a_place_for_every_picture(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    titles = ["RGB", "cloud", *(f"{m}: {kind}" for m in "abc" for kind in ("meshes", "slice"))]
    colours = {title: rng.integers(0, 255, 3) for title in titles}
    scene = {title: np.tile(colour, (24, 32, 1)).astype(np.uint8) for title, colour in colours.items()}
    write_gallery({"scene_0": scene, "scene_1": scene}, tmp_path / "gallery.png")
    shown = np.asarray(Image.open(tmp_path / "gallery.png").convert("RGB"))
    assert shown.shape[1] < 1400
    assert COLUMNS == 4
    for colour in colours.values():
        assert (shown == colour).all(axis=2).sum() > 1000
