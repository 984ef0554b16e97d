"""The whole pipeline's settings as nested frozen dataclasses, and the presets."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields, is_dataclass, replace
from typing import Any

from mapping.contramap import MapConfig
from mapping.errors import ConfigError
from perception.config import PerceptionConfig
from reconstruction.meshing import MeshConfig
from reconstruction.training_set import PaperSamples, TabletopSamples


@dataclass(frozen=True)
class PipelineConfig:
    """Everything reconstruct() can be told. Defaults are the `tabletop` preset."""

    perception: PerceptionConfig = field(default_factory=PerceptionConfig)
    """Cleaning, support plane, fallback segmentation."""
    samples: TabletopSamples | PaperSamples = field(default_factory=TabletopSamples)
    """Hinge points and training samples."""
    map: MapConfig = field(default_factory=lambda: MapConfig(empty_log_odds=2.0))
    """The kernel softmax map and its fit."""
    mesh: MeshConfig = field(default_factory=MeshConfig)
    """Lattice and surface extraction."""

    def as_dict(self) -> dict[str, Any]:
        """Plain nested dict, with the kind of samples named, for scene.json."""
        return {**asdict(self), "preset": preset_of(self)}


def preset(name: str, device: str = "auto") -> PipelineConfig:
    """The configuration of a preset: `tabletop` (default) or `paper` (as published)."""
    configs = {"tabletop": PipelineConfig(), "paper": PipelineConfig(samples=PaperSamples())}
    if name not in configs:
        raise ConfigError(f"unknown preset {name!r}; valid presets: {', '.join(sorted(configs))}")
    config = configs[name]
    return replace(config, map=replace(config.map, device=device))


def preset_of(config: PipelineConfig) -> str:
    """Which preset the samples follow."""
    return "paper" if isinstance(config.samples, PaperSamples) else "tabletop"


def override(config: Any, settings: dict[str, Any], path: str = "") -> Any:
    """A copy of a nested config with settings such as {"mesh": {"spacing": 0.003}}; names valid fields if unknown."""
    known = {f.name for f in fields(config)}
    for name in settings:
        if name not in known:
            where = f"{path}.{name}".lstrip(".")
            raise ConfigError(f"unknown setting {where!r}; valid fields there: {', '.join(sorted(known))}")
    changed = {}
    for name, value in settings.items():
        current = getattr(config, name)
        nested = is_dataclass(current) and isinstance(value, dict)
        changed[name] = override(current, value, f"{path}.{name}") if nested else value
    return replace(config, **changed)
