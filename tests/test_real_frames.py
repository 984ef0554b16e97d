"""Real sensor frames, where they are found: every labelled object comes out as a closed mesh."""

from pathlib import Path

import numpy as np
import pytest

from reconstruction import reconstruct
from sim_scenes.objects.ycb import find_ycb
from tools.real_frames import compare, load_real_frames

DATA = Path(__file__).parents[2] / "shared" / "data" / "real_rgbd"
QUICK = (
    "6dof_graspnet_demo/mustard",
    "6dof_graspnet_demo/cheezit",
    "posecnn_pytorch_demo/000000",
    "posecnn_pytorch_demo/000002",
    "graspnet_example",
)
SINGLE = (
    "blue_mug",
    "cylinder",
    "green_bowl",
    "pepper",
    "red_mug",
    "sugar",
    "white_bowl",
    "white_mug",
)
SLOW = [f"6dof_graspnet_demo/{name}" for name in SINGLE]

pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason=f"no real frames at {DATA}")


@pytest.mark.parametrize("name", [*QUICK, *(pytest.param(n, marks=pytest.mark.slow) for n in SLOW)])
def test_every_labelled_object_is_a_closed_mesh(name):
    real = next(item for item in load_real_frames(DATA) if item.name == name)
    result = reconstruct(real.frame)
    assert all(item.watertight for item in result.objects)
    assert result.skipped == ()
    if real.frame.labels is not None:
        wanted = set(np.unique(real.frame.labels).tolist()) - {0}
        assert {item.label for item in result.objects} == wanted
    for row in compare(real, result, find_ycb()):
        if "iou" in row:
            assert row["iou"] > 0.2
            true = np.array(row["true_size_mm"])
            allowed = np.maximum(0.25 * true, 20)
            assert (np.abs(np.array(row["size_mm"]) - true) <= allowed).all(), row
