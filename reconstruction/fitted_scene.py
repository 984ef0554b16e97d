"""One scene on its way from a frame to meshes: what reconstruct, evaluate and the benchmark share.

Knows the order of the steps and what each needs of the ones before; knows nothing of clocks, files, truth or
pictures. Steps are taken when they are first asked for, each once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mapping.contramap import ContraMap
from mapping.errors import ConfigError
from mapping.threads import map_in_threads
from perception.beside_masks import beside_all_masks
from perception.carried import beds
from perception.frame import Frame
from perception.observation import Observation
from perception.observing import observe
from perception.space import Space
from perception.views.joint import JointObservation
from perception.views.joint_space import each_view, space_of
from perception.views.observing_together import observe_together
from reconstruction.config import PaperSamples, PipelineConfig
from reconstruction.quiet import quiet_objects
from reconstruction.samples.paper import draw_paper
from reconstruction.samples.silent import keep_silent
from reconstruction.samples.tabletop import draw_tabletop
from reconstruction.samples.training_set import TrainingSet
from reconstruction.surface.field import Field, evaluate_field
from reconstruction.surface.joint_surface import JointSurface
from reconstruction.surface.measured_vertices import share_left
from reconstruction.surface.meshing import ObjectSolid, extract_mesh, kept_apart, mesh_of, object_solid
from reconstruction.surface.refined import values_at
from reconstruction.surface.seen_surface import SeenSurface, seen_by
from reconstruction.surface.whole_shape import WholeShape, whole_shape
from reconstruction.warm_start import LEFT, SHAPES, Before, Surface, fit_of_views

OTHER_MARGIN = 0.03
"""Obstacles without a label are mapped this far around what is seen of them [m]."""
OTHER_COARSER = 2
"""Their lattice is this many times as coarse as the objects'."""
BELOW_FLOOR = 0.02
"""Objects are looked for a little below their support, so that their surface can end there [m]."""


@dataclass(frozen=True)
class FittedScene:
    """The steps of one frame; all that they make is in the table frame [m].

    rng: draws the samples, and is used up by them. given: an observation that was made before, so that
    several scenes of one frame share it. further: more views of the scene, their poses in the same world;
    track: equal label numbers are the same object in all of them. before: a map to start the fit from.
    """

    frame: Frame
    config: PipelineConfig
    rng: np.random.Generator
    seed: int = 0
    given: Observation | None = None
    further: tuple[Frame, ...] = ()
    track: bool = False
    before: Before | None = None

    @classmethod
    def of(
        cls,
        frame: Frame,
        config: PipelineConfig,
        seed: int = 0,
        further: Sequence[Frame] = (),
        track: bool = False,
    ) -> FittedScene:
        """A scene of which everything that is random follows one seed. ConfigError when it is no seed."""
        return cls(frame, config, generator(seed), seed, None, tuple(further), track)

    @cached_property
    def observation(self) -> Observation:
        """The frame, cleaned. Raises FrameError when it shows no usable object."""
        if self.given:
            return self.given
        config = self.config.perception
        if self.further:
            return observe_together((self.frame, *self.further), config, self.seed, self.track)
        return observe(self.frame, config, self.seed)

    @property
    def shown(self) -> Frame:
        """The frame that pictures show: the only one, or the first of those used."""
        seen = self.observation
        return seen.views[0].frame if isinstance(seen, JointObservation) else self.frame

    @cached_property
    def space(self) -> Space:
        """Free, occluded and unseen space."""
        return space_of(self.observation, self.config.perception)

    @cached_property
    def samples(self) -> TrainingSet:
        """Hinge points and labelled samples."""
        settings = self.config.samples
        if isinstance(settings, PaperSamples):
            return draw_paper(settings, self.observation, self.space, self.rng)
        if isinstance(self.observation, JointObservation):
            keep_silent(self.observation.views[-1].observation, self.quiet)
        return draw_tabletop(settings, self.observation, self.space, self.rng, self.shapes)

    @cached_property
    def map(self) -> ContraMap:
        """The fitted map: class 0 empty space, k the k-th observed object, then obstacles without a label if
        there are any, the last "uncertain"."""
        observation, training = self.observation, self.samples
        if isinstance(observation, JointObservation):
            return fit_of_views(self.config.map, training, observation, self.before)
        return ContraMap(self.config.map).fit(
            training.X, training.y, hinges=training.hinges, gamma=training.gamma
        )

    @cached_property
    def field(self) -> Field:
        """The map on a lattice, wherever an object can be."""
        mesh = self.config.mesh
        return evaluate_field(self.map, *self.boxes, mesh.spacing, self.floors, mesh.confined)

    @cached_property
    def seen(self) -> SeenSurface | JointSurface | None:
        """What was measured of all objects, to be fused with the map; None where the surface is the map's."""
        if not self.config.mesh.fusion.enabled:
            return None
        if isinstance(self.observation, JointObservation):
            mesh = self.config.mesh
            thinnest = mesh.spacing / mesh.fusion.refine
            return JointSurface.of(self.observation, self.floors, thinnest)
        return replace(seen_by(self.observation, self.frame.depth), floors=self.floors)

    @cached_property
    def shapes(self) -> list[WholeShape | None]:
        """The edges of each observed object whose hidden sides follow from the seen ones, else None."""
        seen, fusion = self.seen, self.config.mesh.fusion
        if seen is None:
            return [None] * len(self.observation.objects)

        views = each_view(self.observation, self.space)

        def bare(places: np.ndarray) -> np.ndarray:
            return np.all([beside_all_masks(*view, places) for view in views], axis=0)

        before = self.before.shapes if self.before else {}
        known = {label: shape for label, shape in before.items() if label in self.quiet}

        def look(index: int) -> WholeShape | None:
            label = self.observation.objects[index].label
            if label in known:
                shape = known[label]
                return None if shape is None else replace(shape, edges=seen.edges(index))
            return whole_shape(seen.edges(index), self._points(index), fusion, bare)

        found = map_in_threads(look, range(len(self.observation.objects)))
        self.observation.memo[SHAPES, fusion] = {
            item.label: shape for item, shape in zip(self.observation.objects, found)
        }
        return found

    def _points(self, index: int) -> np.ndarray:
        """What was measured of an object (N, 3) [m]; a surface seen several times is there once."""
        item, observation = self.observation.objects[index], self.observation
        if isinstance(self.seen, JointSurface) and isinstance(observation, JointObservation):
            return observation.thinned(item.label, self.seen.thinnest)
        return item.points

    @cached_property
    def meshes(self) -> list[Surface | None]:
        """The surface of each observed object, None where the map gives it no volume."""
        objects = self.observation.objects

        def take_up(index: int) -> ObjectSolid | None:
            points = self._points(index)
            return object_solid(self.field, index, self.config.mesh, points, self.seen, self.shapes[index])

        def extract(index: int) -> Surface | None:
            solid = solids[index]
            return None if solid is None else Surface(*mesh_of(solid, self.field, index, self.config.mesh))

        # The largest first: no thread is to start with one when the others have ended.
        sizes = [odds.size for odds in self.field.log_odds]
        asked = [index for index, item in enumerate(objects) if item.label not in self.quiet]
        order = sorted(asked, key=lambda index: -sizes[index])
        solids = kept_apart(dict(zip(order, map_in_threads(take_up, order))), self.field, self.config.mesh)
        surfaces = dict(zip(order, map_in_threads(extract, order)))
        staying = [index for index in range(len(objects)) if index not in surfaces]
        surfaces.update(zip(staying, map_in_threads(self._stays, staying)))
        return [surfaces[index] for index in range(len(objects))]

    @cached_property
    def quiet(self) -> frozenset[int]:
        """Labels of objects of which the latest view says nothing that the earlier map did not know: their
        surfaces stay, and so does what shape they are."""
        if self.before is None:
            return frozenset()
        seen, observation = self.seen, self.observation
        if not isinstance(seen, JointSurface) or self.config.mesh.max_uncertainty is not None:
            return self.before.kept
        assert isinstance(observation, JointObservation)
        return self.before.kept | quiet_objects(observation, seen, self.before)

    def _stays(self, index: int) -> Surface:
        """The surface that an object had in the earlier map, as uncertain as the map is now."""
        assert self.before is not None
        field, label = self.field, self.observation.objects[index].label
        surface = self.before.surfaces[label]
        if label in self.before.kept:
            return surface
        window = field.windows[index]
        nodes = (np.asarray(surface.mesh.vertices) - field.corner(window)) / field.spacing
        uncertainty = np.clip(values_at(field.uncertainty[window], nodes), 0, 1)
        if self.seen is not None:
            left = share_left(self.seen.edges(index), surface.mesh.vertices, self.before.left.get(label))
            self.observation.memo.setdefault(LEFT, {})[label] = left
            uncertainty *= left
        return Surface(surface.mesh, uncertainty, surface.field, surface.placed)

    @cached_property
    def other(self) -> Surface | None:
        """The surface of all obstacles without a label near objects; None where the map has no such class."""
        if self.other_class is None:
            return None
        other, mesh = self.observation.other, self.config.mesh
        points = other.points[other.bulky]
        points = points[self.observation.near_objects(points, self.config.samples.radius)]
        low, high = points.min(0) - OTHER_MARGIN, points.max(0) + OTHER_MARGIN
        spacing = OTHER_COARSER * mesh.spacing
        floors = None if self.floor is None else [self.floor]
        own = [self.other_class]
        lattice = evaluate_field(self.map, low[None], high[None], spacing, floors, False, own)
        found = extract_mesh(lattice, 0, replace(mesh, smallest_part=0.0), points)
        return found and Surface(*found)

    @property
    def other_class(self) -> int | None:
        """The class of obstacles without a label, after the objects' and before "uncertain"; None: none."""
        own = len(self.observation.objects) + 1
        return own if self.samples.y.shape[1] == own + 2 else None

    @property
    def boxes(self) -> tuple[np.ndarray, np.ndarray]:
        """Where each object can be."""
        mesh = self.config.mesh
        return object_space(self.observation, mesh.margin, mesh.margin_share)

    @property
    def floor(self) -> float | None:
        """Height [m] below which no object can be; None when no support was found."""
        lowest = self.config.mesh.floor
        if self.observation.support is None or lowest is None:
            return None
        return min(item.floor for item in self.observation.objects) + lowest

    @cached_property
    def floors(self) -> list[float] | None:
        """Height [m] below which each object cannot be, on whatever it lies; None when no support was
        found."""
        lowest = self.config.mesh.floor
        if self.observation.support is None or lowest is None:
            return None
        objects = self.observation.objects
        return [lowest + (item.floor if bed is None else bed) for item, bed in zip(objects, beds(objects))]


def generator(seed: int) -> np.random.Generator:
    """The generator of a seed; ConfigError when it is not a whole number >= 0."""
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise ConfigError(f"seed must be a whole number >= 0, got {seed!r}")
    return np.random.default_rng(seed)


def object_space(
    observation: Observation, margin: float, share: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Boxes (K, 3), (K, 3) [m] in the table frame that hold every place where an object can be.

    What is hidden of an object reaches no further than `margin` [m] beyond what is seen of it, or than
    `share` of its visible width where that is more, or down to its support.
    """
    lows, highs = (np.array(b) for b in zip(*(o.bounds for o in observation.objects)))
    reach = np.array([[item.reach(margin, share)] for item in observation.objects], lows.dtype)
    lows, highs = lows - reach, highs + reach
    if observation.support is not None:
        lows[:, 2] = np.array([item.floor for item in observation.objects]) - BELOW_FLOOR
    return lows, highs
