"""The whole pipeline's settings as nested frozen dataclasses, and the presets.

Knows names, ranges and what goes with what; knows nothing of how a setting acts. Imports nothing slow.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Annotated, Any, ClassVar, Literal

from mapping.config import FitConfig, ModelConfig
from mapping.errors import ConfigError
from mapping.settings import (
    Checked,
    Count,
    CountOrNone,
    Length,
    NotNegative,
    OpenShare,
    Positive,
    Range,
    Share,
    override,
)
from perception.config import PerceptionConfig

LatticeSpacing = Annotated[float, Range(least=0.0005, most=0.2)]
"""Spacing of lattices and samples around objects on tables [m]."""
PresetName = Literal["tabletop", "paper"]


@dataclass(frozen=True)
class TabletopLabels(Checked):
    """How sure the labels of samples are."""

    SECTION: ClassVar[str] = "samples.labels"

    least_uncertain: Share = 0.085
    """Share of "uncertain" in the label of an occluded sample whose structure is beyond doubt."""
    most_uncertain: Share = 0.95
    """Share of "uncertain" in the label of a sample of which nothing is known."""
    pair_uncertain: Share = 0.02
    """Share of "uncertain" in the labels of a surface pair that nothing speaks against."""
    most_pair_uncertain: Share = 0.8
    """Share of "uncertain" in the label of a sample right behind a seen surface that the prior takes for
    empty: a very thin wall. More ranks errors better and tears more holes into walls."""


@dataclass(frozen=True)
class TabletopSamples(Checked):
    """Samples that use what the depth image says of space: surface pairs, free and occluded samples."""

    SECTION: ClassVar[str] = "samples"

    radius: Length = 0.16
    """The map covers this distance around each object's box [m]."""
    radius_share: Share = 0.5
    """It covers this share of the object's visible width, where that is more than `radius`."""
    coarse_spacing: LatticeSpacing = 0.05
    """Spacing of the hinge lattice over the whole covered space [m]."""
    coarse_gamma: Positive = 1000.0
    """Kernel width of the coarse hinge points [1/m^2]."""
    fine_spacing: LatticeSpacing = 0.025
    """Spacing of the hinge lattice near objects and behind their surface [m]."""
    fine_gamma: Positive = 3000.0
    """Kernel width of the fine hinge points [1/m^2]."""
    fine_distance: NotNegative = 0.03
    """Fine hinge points lie within this distance of a seen object surface [m]."""
    finest_spacing: LatticeSpacing = 0.015
    """Spacing of the hinge lattice on seen object surfaces [m]."""
    finest_gamma: Positive = 5500.0
    """Kernel width of the finest hinge points [1/m^2]."""
    finest_distance: NotNegative | None = 0.0
    """Finest hinge points lie within this distance of a seen object surface [m]; None: there are none."""
    thin_spacing: LatticeSpacing | None = 0.00625
    """Spacing of the hinge lattice on thin walls and thin things [m]; None: there is none."""
    thin_gamma: Positive = 32000.0
    """Kernel width of the hinge points there [1/m^2]."""
    thin: Share = 0.5
    """A wall is thin where the chance that it reaches down to `wall_depth` is below this, or where the
    support plane comes first."""
    surface_voxel: LatticeSpacing = 0.007
    """Voxel that keeps one surface pair of an object [m]."""
    pair_offset: Length = 0.0025
    """A free sample this far before each surface point [m]."""
    pair_depth: Length = 0.0015
    """An object sample this far behind it [m]; less than before it, for walls are thin."""
    wall_depth: Length = 0.007
    """A third sample this far behind it [m]: is there more than a thin wall?"""
    near_spacing: LatticeSpacing = 0.010
    """Spacing of samples of every kind near seen object surfaces [m]."""
    near_distance: Length = 0.02
    """How far from a seen object surface is near [m]."""
    free_spacing: LatticeSpacing = 0.03
    """Spacing of free samples elsewhere [m]."""
    occluded_spacing: LatticeSpacing = 0.012
    """Spacing of samples in occluded space elsewhere [m]."""
    unknown_distance: NotNegative = 0.06
    """Samples where nothing was measured lie within this distance of an object's box [m]."""
    floor_spacing: LatticeSpacing = 0.013
    """Spacing of empty samples right under the support plane [m]."""
    foot_spacing: LatticeSpacing = 0.008
    """Spacing of empty samples right under what may be an object's hidden foot [m]."""
    foot_distance: NotNegative = 0.02
    """A foot lies within this distance of the box of what is seen of its object [m]."""
    below_spacing: LatticeSpacing = 0.03
    """Spacing of empty samples deeper under the support plane [m]."""
    below_depth: Length = 0.04
    """Thickness of the layer under the support plane that is known to be empty of objects [m]."""
    wall: NotNegative = 0.014
    """Hidden space nearer than this behind an object's seen surface is not sampled [m]: surface pairs and
    wall samples say what is there. With such samples, thin walls came out as lace."""
    prior: Literal["learned", "none"] = "learned"
    """What guesses the structure of occluded space: the learned occlusion prior, or a thin shell (which also
    stands in where no support plane says what is up)."""
    labels: TabletopLabels = field(default_factory=TabletopLabels)
    """How sure the labels are."""
    shell: Length = 0.02
    """Without a prior, occluded space nearer than this to a seen surface leans to that object [m]."""
    pairs: bool = True
    """False, for ablations: one sample on each surface point instead of a pair around it."""
    noise: Literal["occluded", "near", "everywhere"] = "occluded"
    """Where "uncertain" is learned: in occluded space or, for ablations, evenly near objects or all over."""


@dataclass(frozen=True)
class PaperSamples(Checked):
    """Hinge points and samples as V-PRISM and the paper draw them (paper, Section V-D)."""

    SECTION: ClassVar[str] = "samples"

    hinge_spacing: LatticeSpacing = 0.05
    """Spacing of the hinge lattice near objects [m]."""
    hinge_radius: Length = 0.15
    """Hinge points lie within this distance of an object's box centre [m]."""
    surface_hinges: Count = 32
    """Random surface points an object used as further hinge points."""
    gamma: Positive = 1000.0
    """Kernel width [1/m^2]."""
    ray_step: Annotated[float, Range(least=0.005, most=100)] = 0.10
    """One free sample in each step of every ray [m]."""
    radius: Length = 0.25
    """Samples lie within this distance of an object's box centre [m]."""
    empty_voxel: LatticeSpacing = 0.015
    """Voxel that keeps one empty sample [m]."""
    surface_voxel: LatticeSpacing = 0.01
    """Voxel that keeps one surface sample of an object [m]."""
    noise_ratio: OpenShare = 0.025
    """Noise samples as a share of the other samples, drawn evenly near objects."""


@dataclass(frozen=True)
class FusionConfig(Checked):
    """How what was measured and what the map says become one surface."""

    SECTION: ClassVar[str] = "mesh.fusion"

    enabled: bool = True
    """False: the surface is the map's alone, on its own lattice."""
    refine: Count = 2
    """Cells near the surface are divided by this along each axis."""
    wall: Length = 0.004
    """What was seen is at least this thick, unless free space shows it to be thinner [m]."""
    round_bodies: bool = True
    """What is seen of cups, bowls, cans and balls is turned about their axis where it is hidden."""
    cuboids: bool = True
    """Cartons and books of which enough is seen to know all of their sides have these where they are
    hidden."""
    unseen_walls: bool = True
    """Tunnels through an object that no ray passed are closed, where the map thinks a wall likeliest."""
    fair: CountOrNone = 4
    """Rounds of smoothing where the surface was not measured, and at outlines; 0: teeth and steps stay."""


@dataclass(frozen=True)
class MeshConfig(Checked):
    """How meshes are taken from the map."""

    SECTION: ClassVar[str] = "mesh"

    spacing: LatticeSpacing = 0.005
    """Lattice spacing [m]; also about the edge length of the triangles."""
    margin: Length = 0.10
    """The hidden part of an object is looked for this far beyond its visible points [m]."""
    margin_share: Share = 0.4
    """It is looked for as far as this share of its visible width, where that is more than `margin`."""
    floor: float | None = -0.0015
    """Nothing reaches below this height over the support plane [m]; None: meshes may."""
    smallest_part: Share = 0.05
    """Parts smaller than this share of the largest part are dropped, unless they were seen."""
    max_uncertainty: OpenShare | None = None
    """Keep only what is less uncertain than this (0..1); None keeps all."""
    confined: bool = True
    """Further from an object than `margin`, the map is evaluated as if it did not exist: half the work."""
    keep_seen: bool = True
    """Every cell that holds a seen point of an object belongs to it in part, so that things thinner than a
    cell stay whole."""
    simplify: Length | None = None
    """Triangles are merged where that moves 99 % of a surface by no more than this [m]: a third to a fifth of
    them are left at 0.0003. Needs the extra `export`. None keeps them all."""
    fusion: FusionConfig = field(default_factory=FusionConfig)
    """What was measured stays where it was measured."""


@dataclass(frozen=True)
class PipelineConfig(Checked):
    """Everything reconstruct() can be told. Defaults are the `tabletop` preset."""

    perception: PerceptionConfig = field(default_factory=PerceptionConfig)
    """Cleaning, support plane, fallback segmentation."""
    samples: TabletopSamples | PaperSamples = field(default_factory=TabletopSamples)
    """Hinge points and training samples."""
    map: ModelConfig = field(
        # Stops well before the optimum and drops features below two hundredths: a third less work, and no
        # figure of the meshes is worse, for what is seen is fused from the depth image.
        default_factory=lambda: ModelConfig(
            empty_log_odds=2.0, fit_cutoff=2e-2, fit=FitConfig(tolerance=1.2e-3, warm=2.0, memory=4)
        )
    )
    """The kernel softmax map and its fit."""
    mesh: MeshConfig = field(default_factory=MeshConfig)
    """Lattice and surface extraction."""

    @property
    def preset(self) -> str:
        """Which preset the samples follow."""
        return "paper" if isinstance(self.samples, PaperSamples) else "tabletop"

    def as_dict(self) -> dict[str, Any]:
        """Plain nested dict, with the preset named, for scene.json."""
        return {**asdict(self), "preset": self.preset}


TABLETOP = PipelineConfig()
"""The preset that is used where none is named."""


def preset(
    name: str = "tabletop", device: str | None = None, prior: str | None = None, **sections: dict[str, Any]
) -> PipelineConfig:
    """The configuration of a preset: `tabletop` or `paper` (as published, which has no prior).

    device, prior: shorthands for map.device and samples.prior; sections: nested settings, such as
    mesh={"spacing": 0.003}. Raises ConfigError that names the valid presets, settings or values.
    """
    if name not in ("tabletop", "paper"):
        raise ConfigError(f"unknown preset {name!r}; valid presets: paper, tabletop")
    config = TABLETOP
    if name == "paper":
        config = PipelineConfig(
            samples=PaperSamples(),
            map=ModelConfig(empty_log_odds=2.0, fit=FitConfig(tolerance=3e-4)),
            mesh=MeshConfig(
                margin_share=0.0,
                floor=None,
                confined=False,
                keep_seen=False,
                fusion=FusionConfig(enabled=False),
            ),
        )
    if device is not None:
        config = override(config, {"map": {"device": device}})
    if prior is not None:
        config = with_prior(config, prior)
    return override(config, sections)


def pipeline_of(stored: dict[str, Any]) -> PipelineConfig:
    """The configuration that as_dict gave; ConfigError when it is of another version."""
    return override(
        preset(stored["preset"]), {key: value for key, value in stored.items() if key != "preset"}
    )


def with_prior(config: PipelineConfig, prior: str) -> PipelineConfig:
    """The same with another prior; the paper preset has none, and refuses any other."""
    if isinstance(config.samples, TabletopSamples):
        return override(config, {"samples": {"prior": prior}})
    if prior != "none":
        raise ConfigError(f"the paper preset has no prior; valid there: none, got {prior!r}")
    return replace(config)
