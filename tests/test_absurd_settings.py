"""Absurd settings are one line that names what is valid; settings come from files; their texts are help."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import pytest
from test_settings import PAPER, TABLETOP, nested

from mapping import ConfigError, MapConfig
from mapping.settings import Checked, override
from perception.frame import Frame
from tools.cli import main

ABSURD = [
    ("mesh.spacing", "abc", "a number >= 0.0005"),
    ("mesh.spacing", "-0.005", ">= 0.0005 and <= 0.2"),
    ("mesh.spacing", "0", ">= 0.0005"),
    ("mesh.spacing", "1e-9", ">= 0.0005"),
    ("mesh.spacing", "null", "a number"),
    ("mesh.spacing", "NaN", "a number"),
    ("mesh.spacing", "Infinity", "a number"),
    ("mesh.spacing", "true", "a number"),
    ("mesh.spacing", "[0.005]", "a number"),
    ("mesh.spacing", "1" + "0" * 400, "a number"),
    ("mesh.margin", "-1", "> 0"),
    ("mesh.margin", "1e9", "<= 100"),
    ("mesh.floor", "low", "a number"),
    ("mesh.smallest_part", "2", "<= 1"),
    ("mesh.max_uncertainty", "1", "< 1"),
    ("mesh.max_uncertainty", "0", "> 0"),
    ("mesh.max_uncertainty", "-0.1", "> 0"),
    ("mesh.confined", "maybe", "true or false"),
    ("mesh.confined", "1", "true or false"),
    ("mesh.spacin", "0.1", "spacing"),
    ("mesh", "0.1", "spacing"),
    ("mesg.spacing", "0.1", "map, mesh, perception, samples"),
    ("samples.prior", "bogus", "learned, none"),
    ("samples.prior", "1", "learned, none"),
    ("samples.near_spacing", "0", ">= 0.0005"),
    ("samples.noise", "loud", "occluded, near, everywhere"),
    ("samples.radius", "-0.1", "> 0"),
    ("samples.radius", "1e6", "<= 100"),
    ("samples.coarse_gamma", "0", "> 0"),
    ("samples.thin", "1.5", "<= 1"),
    ("samples.thin_spacing", "0", ">= 0.0005"),
    ("samples.finest_distance", "-1", ">= 0"),
    ("samples.labels.least_uncertain", "7", "<= 1"),
    ("samples.labels.leest", "0.1", "least_uncertain"),
    ("samples.labels", "0.5", "least_uncertain"),
    ("samples.pairs", "null", "true or false"),
    ("map.gamma", "7", "far_uncertainty"),
    ("map.hinge_spacing", "0.1", "fit_cutoff"),
    ("map.l2", "-1", ">= 0"),
    ("map.l2", "{}", "a number"),
    ("map.far_uncertainty", "1", "< 1"),
    ("map.fit_cutoff", "0", "> 0"),
    ("map.fit.max_iterations", "0", ">= 1"),
    ("map.fit.max_iterations", "2.5", "a whole number"),
    ("map.fit.memory", "many", "a whole number"),
    ("map.device", "abacus", "auto, cpu, cuda"),
    ("perception.minimum_pixels", "0", ">= 1"),
    ("perception.depth_noise", "-0.1", "> 0"),
    ("perception.grazing_angle", "90", "< 90"),
    ("perception.plane_minimum_share", "1", "< 1"),
    ("perception.use_plane", "2", "true or false"),
    ("perception.plane_iterations", "1e3", "a whole number"),
]


@pytest.mark.parametrize(("name", "text", "valid"), ABSURD)
def test_an_absurd_setting_is_one_line_that_names_what_is_valid(
    name: str, text: str, valid: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for words in ([f"--{name}", text], ["--set", f"{name}={text}"]):
        assert main(["map", str(tmp_path / "no frame is read"), "--out", str(tmp_path / "out"), *words]) == 2
        said = capsys.readouterr().err.strip()
        assert "\n" not in said
        assert said.startswith("contramap: error: ")
        assert valid in said, said
        assert not (tmp_path / "out").exists()
    with pytest.raises(ConfigError) as caught:
        override(TABLETOP, nested(name, json.loads(text) if text[0] in "-0123456789[{tnNI" else text))
    assert valid in str(caught.value)


@pytest.mark.parametrize(
    ("words", "valid"),
    [
        (["--preset", "best"], "paper, tabletop"),
        (["--preset", "paper", "--samples.prior", "none"], "hinge_spacing"),
        (["--preset", "paper", "--prior", "learned"], "none"),
        (["--seed", "-1"], "seed must be a whole number >= 0"),
        (["--seed", "many"], "--seed"),
        (["--spacing", "-1"], ">= 0.0005"),
        (["--device", "abacus"], "auto, cpu, cuda"),
        (["--prior", "bogus"], "learned, none"),
    ],
)
def test_absurd_flags_are_one_line(
    words: list[str], valid: str, tmp_path: Path, capsys: Any, tabletop_frame: Frame
) -> None:
    from perception import save_frame

    save_frame(tabletop_frame, tmp_path / "frame")
    assert main(["map", str(tmp_path / "frame"), "--out", str(tmp_path / "out"), *words]) == 2
    said = capsys.readouterr().err.strip()
    assert "\n" not in said
    assert valid in said, said


def test_settings_come_from_yaml_and_json_files(tmp_path: Path) -> None:
    from tools.options import pipeline_config

    (tmp_path / "a.yaml").write_text("mesh:\n  spacing: 0.004\nsamples: {prior: none}\n")
    (tmp_path / "a.json").write_text(json.dumps({"preset": "tabletop", "map": {"l2": 1e-5}}))
    assert pipeline_config(TABLETOP, tmp_path / "a.yaml").mesh.spacing == 0.004
    assert pipeline_config(TABLETOP, tmp_path / "a.yaml").samples.prior == "none"  # type: ignore[union-attr]
    assert pipeline_config(TABLETOP, tmp_path / "a.json").map.l2 == 1e-5
    (tmp_path / "bad.yaml").write_text("mesh: [1, 2")
    with pytest.raises(ConfigError, match=r"bad\.yaml"):
        pipeline_config(TABLETOP, tmp_path / "bad.yaml")


def test_every_section_says_what_each_setting_is() -> None:
    """The text under each field is its help: none may be without."""
    from tyro._docstrings import get_field_docstring

    def sections(config: Any) -> list[Any]:
        inner = [getattr(config, field.name) for field in fields(config)]
        return [config, *(part for value in inner if is_dataclass(value) for part in sections(value))]

    for section in [*sections(TABLETOP), *sections(PAPER), MapConfig()]:
        assert isinstance(section, Checked)
        for field in fields(section):
            assert get_field_docstring(type(section), field.name, ()), (
                f"{type(section).__name__}.{field.name}"
            )


def test_reading_settings_costs_no_heavy_import() -> None:
    code = (
        "import sys, reconstruction.config;"
        "heavy = {'numpy', 'torch', 'cv2', 'trimesh', 'scipy', 'open3d'} & set(sys.modules);"
        "sys.exit(str(heavy) if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
