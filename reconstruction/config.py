"""The whole pipeline's settings as nested frozen dataclasses, and the presets."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields, is_dataclass, replace
from typing import Any

from mapping.contramap import MapConfig
from mapping.errors import ConfigError
from mapping.softmax import FitConfig
from perception.config import PerceptionConfig
from reconstruction.samples.paper import PaperSamples
from reconstruction.samples.tabletop import TabletopSamples
from reconstruction.surface.meshing import MeshConfig

PRIORS = ("learned", "none")


@dataclass(frozen=True)
class PipelineConfig:
    """Everything reconstruct() can be told. Defaults are the `tabletop` preset."""

    perception: PerceptionConfig = field(default_factory=PerceptionConfig)
    """Cleaning, support plane, fallback segmentation."""
    samples: TabletopSamples | PaperSamples = field(default_factory=TabletopSamples)
    """Hinge points and training samples."""
    map: MapConfig = field(
        # Stops a little before the optimum, and drops features below a hundredth: half the work, and meshes
        # that are hardly worse.
        default_factory=lambda: MapConfig(
            empty_log_odds=2.0, fit_cutoff=1e-2, fit=FitConfig(tolerance=6e-4, memory=4)
        )
    )
    """The kernel softmax map and its fit."""
    mesh: MeshConfig = field(default_factory=MeshConfig)
    """Lattice and surface extraction."""

    def as_dict(self) -> dict[str, Any]:
        """Plain nested dict, with the kind of samples named, for scene.json."""
        return {**asdict(self), "preset": preset_of(self)}


def preset(name: str, device: str = "auto", prior: str | None = None) -> PipelineConfig:
    """The configuration of a preset: `tabletop` (default) or `paper` (as published, which has no prior)."""
    paper = PipelineConfig(
        samples=PaperSamples(),
        map=MapConfig(empty_log_odds=2.0, fit=FitConfig(tolerance=3e-4)),
        mesh=MeshConfig(floor=None, confined=False, keep_seen=False),
    )
    configs = {"tabletop": PipelineConfig(), "paper": paper}
    if name not in configs:
        raise ConfigError(f"unknown preset {name!r}; valid presets: {', '.join(sorted(configs))}")
    config = configs[name]
    if prior is not None:
        if prior not in PRIORS:
            raise ConfigError(f"unknown prior {prior!r}; valid: {', '.join(PRIORS)}")
        if isinstance(config.samples, TabletopSamples):
            samples = replace(config.samples, prior="learned" if prior == "learned" else "none")
            config = replace(config, samples=samples)
    return replace(config, map=replace(config.map, device=device))


def preset_of(config: PipelineConfig) -> str:
    """Which preset the samples follow."""
    return "paper" if isinstance(config.samples, PaperSamples) else "tabletop"


def override(config: Any, settings: dict[str, Any], path: str = "") -> Any:
    """A copy of a nested config with settings such as {"mesh": {"spacing": 0.003}}.

    Raises ConfigError that names the valid fields where a setting is unknown.
    """
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
