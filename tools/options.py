"""Options that several commands share: the pipeline's configuration, and figures as JSON."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from mapping.errors import ConfigError, DataError
from mapping.files import write_atomically
from mapping.settings import override
from reconstruction.config import PipelineConfig, with_prior


def pipeline_config(
    settings: PipelineConfig,
    config_file: Path | None = None,
    texts: tuple[str, ...] = (),
    device: str | None = None,
    prior: str | None = None,
    spacing: float | None = None,
    max_uncertainty: float | None = None,
) -> PipelineConfig:
    """Settings as the command line gave them, then a file's, then `section.field=value`, then shorthands.

    Raises ConfigError for unknown settings (naming the valid ones) and values out of range.
    """
    config = settings
    if config_file is not None:
        # A scene.json's `config` names its preset, which --preset has chosen already.
        stored = {name: value for name, value in read_settings(config_file).items() if name != "preset"}
        config = override(config, stored)
    for text in texts:
        if "=" not in text:
            raise ConfigError(f"--set wants section.field=value, got {text!r}")
        config = override(config, nested_setting(text))
    if prior is not None:
        config = with_prior(config, prior)
    shorthands: dict[str, dict[str, Any]] = {
        "map": {"device": device},
        "mesh": {"spacing": spacing, "max_uncertainty": max_uncertainty},
    }
    given = {
        section: {name: value for name, value in fields.items() if value is not None}
        for section, fields in shorthands.items()
    }
    return override(config, given)


def nested_setting(text: str) -> dict[str, Any]:
    """{"section": {"field": value}} from `section.field=value`; numbers, true, false and null as such."""
    name, _, value = text.partition("=")
    nested: Any = _value(value)
    for part in reversed(name.split(".")):
        nested = {part: nested}
    return nested


def write_json(figures: dict[str, Any], path: Path | None) -> None:
    """Write figures to a temporary name and rename; None writes nothing.

    Raises ConfigError when a file is there that is no JSON, and so is not replaced.
    """
    if path is None:
        return
    if path.is_dir():
        raise ConfigError(f"{path} is a folder; figures need a file name")
    if path.is_file() and path.stat().st_size and path.read_bytes()[:1] not in (b"{", b"["):
        raise ConfigError(f"{path} is there and is no JSON, so it is not replaced; name another file")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"{path}: cannot write the figures ({error.strerror})") from error
    write_atomically(path, (json.dumps(figures, indent=2) + "\n").encode())


def read_settings(path: Path) -> dict[str, Any]:
    """Nested settings from a YAML or JSON file; ConfigError when it is neither or holds something else."""
    import yaml

    try:
        text = path.read_text()
        # JSON first: YAML 1.1 reads 1e-5 as a text.
        try:
            settings = json.loads(text)
        except ValueError:
            settings = yaml.safe_load(text)
    except (OSError, ValueError, yaml.YAMLError, RecursionError) as error:
        reason = " ".join(str(error).split())
        raise ConfigError(f"{path}: not a readable YAML or JSON file of settings ({reason})") from error
    if not isinstance(settings, dict):
        raise ConfigError(f"{path}: settings must be an object such as {{'mesh': {{'spacing': 0.003}}}}")
    return settings


def _value(text: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return text
