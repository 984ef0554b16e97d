"""Hilbert map (Ramos and Ott 2016): the same kernel softmax without noise and without the uncertain class."""

from __future__ import annotations

from dataclasses import replace

from mapping.config import MapConfig, ModelConfig
from mapping.contramap import ContraMap


class HilbertMap(ContraMap):
    """Kernel softmax over the observed classes 0..C-1; where no hinge point reaches, all are equally likely.

    Same features, loss and solver as ContraMap, so that a comparison shows the effect of the uncertain class
    alone. Fit it to observed samples only; every column of `predict_proba` is an observed class.
    """

    def __init__(self, config: ModelConfig | None = None) -> None:
        super().__init__(replace(config or MapConfig(), far_uncertainty=None))
