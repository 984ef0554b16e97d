"""ContraMap as a method of the evaluation: exactly the scene that reconstruct() would deliver.

Knows how a scene of other settings answers in the frame and the order of objects that it is judged in.
"""

from __future__ import annotations

import numpy as np

from mapping.settings import override
from perception.camera import invert_rigid, transform
from reconstruction.config import PipelineConfig, preset
from reconstruction.fitted_scene import FittedScene, Surface
from tools.evaluation.fitted_map import FittedMap, View, nodes
from tools.options import nested_setting


class FittedContraMap(FittedMap):
    """ContraMap: uncertainty is the probability of its uncertain class."""

    def __init__(self, scene: FittedScene, view: View) -> None:
        self.scene, self.keeps_seen = scene, scene.config.mesh.keep_seen
        own = scene.observation
        labels = [item.label for item in own.objects]
        # Settings of perception may find other objects, in another order, on another plane.
        self.column = [
            labels.index(item.label) + 1 if item.label in labels else None
            for item in view.observation.objects
        ]
        self.alike = own is view.observation
        self.T_own_view = own.T_table_camera @ invert_rigid(view.observation.T_table_camera)
        self.lattice = scene.map.lattice()
        training = scene.samples
        observed = training.X[training.y.argmax(1) < training.y.shape[1] - 1]
        self.samples = observed if self.alike else transform(invert_rigid(self.T_own_view), observed)

    def predict(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        local = points if self.alike else transform(self.T_own_view, points)
        structure, uncertainty = self.scene.map.predict_known(local)
        return self._as_judged(structure), uncertainty

    def occupancy(self, axes: list[np.ndarray], index: int) -> np.ndarray:
        column = self.column[index]
        if column is None:
            return np.zeros([len(axis) for axis in axes], np.float32)
        if not self.alike:
            return self.predict(nodes(axes))[0][:, index + 1].reshape([len(axis) for axis in axes])
        probability = self.lattice.share(axes, column, len(self.scene.observation.objects) + 1)
        if self.scene.floor is not None:
            probability[:, :, axes[2] < self.scene.floor] = 0
        return probability

    def meshes(self, view: View) -> list[Surface | None]:
        found = [None if column is None else self.scene.meshes[column - 1] for column in self.column]
        return found if self.alike else [item and _moved(item, self.T_own_view) for item in found]

    def _as_judged(self, structure: np.ndarray) -> np.ndarray:
        """Probabilities (N, K+1) in the order of the judged objects; what they lack counts as empty."""
        if self.alike:
            return structure
        out = np.zeros((len(structure), len(self.column) + 1), np.float32)
        for index, column in enumerate(self.column):
            if column is not None:
                out[:, index + 1] = structure[:, column]
        out[:, 0] = 1 - out[:, 1:].sum(1)
        return out


def _moved(surface: Surface, T_own_view: np.ndarray) -> Surface:
    mesh = surface.mesh.copy()
    mesh.apply_transform(invert_rigid(T_own_view))
    return Surface(mesh, surface.uncertainty)


def fit_contramap(config: PipelineConfig, view: View, rng: np.random.Generator) -> FittedMap:
    """ContraMap with a configuration; perception's own settings are used where they are not the default."""
    shared = view.observation if config.perception == PipelineConfig().perception else None
    return FittedContraMap(FittedScene(view.frame, config, rng, given=shared), view)


def configuration(preset_name: str, settings: list[str]) -> PipelineConfig:
    """A preset with settings `section.field=value`; a name without a dot is a field of `samples`."""
    config = preset(preset_name, "cpu")
    for setting in settings:
        named = setting if "." in setting.partition("=")[0] else f"samples.{setting}"
        config = override(config, nested_setting(named))
    return config
