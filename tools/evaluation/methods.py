"""The methods of the evaluation by name, and the one place that reads a method's name."""

from __future__ import annotations

from functools import partial

import numpy as np

from mapping.errors import ConfigError
from tools.evaluation.baselines import FittedDenseVPrism, FittedHilbert, FittedOneVsRest, FittedVPrism
from tools.evaluation.contramap import configuration, fit_contramap
from tools.evaluation.fitted_map import FittedMap, MethodSpec, View


def _tsdf(view: View, rng: np.random.Generator) -> FittedMap:
    from tools.evaluation.tsdf import FittedTsdf  # Open3D, which takes a second to import

    return FittedTsdf(view)


def _contramap(preset_name: str, view: View, rng: np.random.Generator) -> FittedMap:
    return fit_contramap(configuration(preset_name, []), view, rng)


METHODS = {
    spec.name: spec
    for spec in (
        MethodSpec("contramap", partial(_contramap, "tabletop"), "the preset tabletop"),
        MethodSpec("contramap-paper", partial(_contramap, "paper"), "the preset paper"),
        MethodSpec("hilbert", FittedHilbert, "a softmax Hilbert map without noise"),
        MethodSpec("bayesian-hilbert", FittedOneVsRest, "one Bayesian Hilbert map a class"),
        MethodSpec("vprism", FittedVPrism.published, "V-PRISM"),
        MethodSpec("vprism-bound", FittedVPrism.with_bound, "V-PRISM, alpha as its bound has it"),
        MethodSpec("vprism-dense", FittedDenseVPrism, "V-PRISM, no feature dropped: for its time"),
        MethodSpec("tsdf", _tsdf, "a truncated signed distance field an object", seeded=False),
    )
}
PRESETS = {"contramap": "tabletop", "contramap-paper": "paper"}
"""Methods that take settings -> their preset."""


def method(name: str) -> MethodSpec:
    """A method by name; ContraMap's may carry settings: `contramap:prior=none,map.l2=1e-5` (a name without a
    dot is a field of `samples`). ConfigError lists the valid names, settings or values."""
    base, _, text = name.partition(":")
    if base not in METHODS:
        raise ConfigError(f"unknown method {base!r}; valid methods: {', '.join(METHODS)}")
    if not text:
        return METHODS[base]
    if base not in PRESETS:
        raise ConfigError(
            f"{base} takes no settings, got {text!r}; valid with settings: {', '.join(PRESETS)}"
        )
    config = configuration(PRESETS[base], text.split(","))
    return MethodSpec(name, partial(fit_contramap, config), METHODS[base].about)
