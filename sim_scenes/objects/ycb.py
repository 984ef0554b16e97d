"""Finds and reads YCB scans in the official layout: `<ID>/google_16k/textured.obj`."""

from __future__ import annotations

import os
from functools import lru_cache
from pathlib import Path

from mapping.errors import DataError
from mapping.files import cache_dir
from sim_scenes.objects.object_model import ObjectModel, load_model

MESH_FILE = Path("google_16k/textured.obj")
REPOSITORY = Path(__file__).resolve().parents[2]

YCB_IDS: tuple[str, ...] = (
    "002_master_chef_can",
    "003_cracker_box",
    "004_sugar_box",
    "005_tomato_soup_can",
    "006_mustard_bottle",
    "007_tuna_fish_can",
    "008_pudding_box",
    "009_gelatin_box",
    "010_potted_meat_can",
    "011_banana",
    "012_strawberry",
    "013_apple",
    "014_lemon",
    "015_peach",
    "016_pear",
    "017_orange",
    "018_plum",
    "019_pitcher_base",
    "021_bleach_cleanser",
    "022_windex_bottle",
    "024_bowl",
    "025_mug",
    "026_sponge",
    "028_skillet_lid",
    "029_plate",
    "030_fork",
    "031_spoon",
    "032_knife",
    "033_spatula",
    "035_power_drill",
    "036_wood_block",
    "037_scissors",
    "038_padlock",
    "040_large_marker",
    "042_adjustable_wrench",
    "043_phillips_screwdriver",
    "044_flat_screwdriver",
    "048_hammer",
    "050_medium_clamp",
    "051_large_clamp",
    "052_extra_large_clamp",
    "053_mini_soccer_ball",
    "054_softball",
    "055_baseball",
    "056_tennis_ball",
    "057_racquetball",
    "058_golf_ball",
    "059_chain",
    "061_foam_brick",
    "062_dice",
    "065-a_cups",
    "065-b_cups",
    "065-c_cups",
    "065-d_cups",
    "065-e_cups",
    "065-f_cups",
    "065-g_cups",
    "065-h_cups",
    "065-i_cups",
    "065-j_cups",
    "070-a_colored_wood_blocks",
    "071_nine_hole_peg_test",
    "072-a_toy_airplane",
    "073-a_lego_duplo",
    "077_rubiks_cube",
)
"""Objects with a google_16k scan that `contramap fetch ycb` downloads by default."""


def find_ycb(directory: str | Path | None = None) -> Path | None:
    """The first folder with YCB scans, or None.

    Looked for in: `directory` (DataError if it holds none), $YCB_DIR (likewise), `../shared/data/ycb` from
    the repository and from the current folder, and where `contramap fetch ycb` puts the scans.
    """
    for given, origin in ((directory, "the given folder"), (os.environ.get("YCB_DIR"), "YCB_DIR")):
        if given:
            folder = Path(given).expanduser()
            if not list_models(folder):
                raise DataError(
                    f"{folder} ({origin}): no YCB scans found; expected <ID>/{MESH_FILE} in it "
                    "(`contramap fetch ycb --to DIR` downloads them)"
                )
            return folder
    for folder in (REPOSITORY / "../shared/data/ycb", Path("../shared/data/ycb"), default_ycb_dir()):
        if list_models(folder):
            return folder.resolve()
    return None


def default_ycb_dir() -> Path:
    """Where `contramap fetch ycb` puts the scans when no folder is named."""
    return cache_dir() / "ycb"


def list_models(folder: str | Path) -> list[str]:
    """Sorted IDs of the scans in a YCB folder; empty when there are none or no such folder."""
    return sorted(path.parent.parent.name for path in Path(folder).glob(f"*/{MESH_FILE.as_posix()}"))


def mesh_path(folder: str | Path, model_id: str) -> Path:
    """Path of one scan's mesh; DataError naming some valid IDs when it is not there."""
    path = Path(folder) / model_id / MESH_FILE
    if not path.is_file():
        known = list_models(folder)
        raise DataError(f"{folder}: no YCB scan {model_id!r}; it has {', '.join(known[:8])} ...")
    return path


def load_ycb(folder: str | Path, model_id: str) -> ObjectModel:
    """Read one scan [m] with its texture."""
    return _load(str(Path(folder).resolve()), model_id)


@lru_cache(maxsize=128)
def _load(folder: str, model_id: str) -> ObjectModel:
    return load_model(mesh_path(folder, model_id), model_id, "ycb")
