"""Options that several commands share: the pipeline's configuration, and figures as JSON."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mapping.errors import ConfigError, DataError

if TYPE_CHECKING:
    from reconstruction.config import PipelineConfig


def pipeline_config(
    preset_name: str,
    device: str = "auto",
    prior: str | None = None,
    settings: tuple[str, ...] = (),
    config_file: Path | None = None,
    spacing: float | None = None,
    max_uncertainty: float | None = None,
) -> PipelineConfig:
    """The preset, then a JSON file of nested settings, then `section.field=value` settings, then flags.

    Raises ConfigError for unknown presets and fields (naming the valid ones) and unreadable values.
    """
    from reconstruction.config import override, preset

    config = preset(preset_name, device, prior)
    if config_file is not None:
        # A scene.json's `config` names its preset, which --preset has chosen already.
        stored = {name: value for name, value in _read_json(config_file).items() if name != "preset"}
        config = override(config, stored)
    for setting in settings:
        if "=" not in setting:
            raise ConfigError(f"--set wants section.field=value, got {setting!r}")
        config = override(config, nested_setting(setting))
    mesh = config.mesh
    if spacing is not None:
        mesh = replace(mesh, spacing=spacing)
    if max_uncertainty is not None:
        mesh = replace(mesh, max_uncertainty=max_uncertainty)
    return replace(config, mesh=mesh)


def nested_setting(text: str) -> dict[str, Any]:
    """{"section": {"field": value}} from `section.field=value`; numbers, true, false and null as such."""
    name, _, value = text.partition("=")
    nested: Any = _value(value)
    for part in reversed(name.split(".")):
        nested = {part: nested}
    return nested


def write_json(figures: dict[str, Any], path: Path | None) -> None:
    """Write figures to a temporary name and rename; None writes nothing."""
    if path is None:
        return
    partial = path.with_name(path.name + ".part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_text(json.dumps(figures, indent=2) + "\n")
        os.replace(partial, path)
    except OSError as error:
        raise DataError(f"{path}: cannot write the figures ({error.strerror})") from error


def _value(text: str) -> Any:
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        return text


def _read_json(path: Path) -> dict[str, Any]:
    try:
        settings = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: not a readable JSON file of settings ({error})") from error
    if not isinstance(settings, dict):
        raise ConfigError(f"{path}: settings must be a JSON object such as {{'mesh': {{'spacing': 0.003}}}}")
    return settings
