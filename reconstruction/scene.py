"""From one RGB-D frame to metric meshes with uncertainty: the pipeline, top to bottom."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from time import perf_counter

import numpy as np
import trimesh

from mapping.errors import ConfigError, DataError, FrameError
from mapping.threads import map_in_threads
from perception.camera import invert_rigid, transform
from perception.frame import Frame
from perception.observation import Observation, ObservedObject, Skipped
from perception.views.choosing import without_the_least_new
from perception.views.joint import JointObservation, View
from perception.views.observing_together import observe_together
from perception.views.placing import relabelled
from perception.views.repeated import same_view
from perception.views.touching import touches
from reconstruction.bounding import bounds, upright_box
from reconstruction.config import PipelineConfig, pipeline_of
from reconstruction.fitted_scene import FittedScene, generator
from reconstruction.pictures.palette import paint
from reconstruction.result import ObjectField, OtherObstacles, ReconstructedObject, Reconstruction
from reconstruction.surface.field import Field, overlap, window_of, within
from reconstruction.surface.parts import SEEN_POINTS
from reconstruction.warm_start import LEFT, LIFTED, SHAPES, Before, Surface

STAGES = {
    "observation": "observe",
    "space": "space",
    "seen": "seen",
    "shapes": "shapes",
    "samples": "samples",
    "map": "fit",
    "field": "field",
    "meshes": "mesh",
}
"""Step of the scene -> the name its time is reported under."""
WELL_BEYOND = 0.01
"""Measured points this far beyond the box around an object's mesh are said to be missing from it [m]."""


def reconstruct(
    frame: Frame | Sequence[Frame],
    config: PipelineConfig | None = None,
    seed: int = 0,
    track: bool = False,
) -> Reconstruction:
    """Map a frame: one watertight mesh [m, world frame] with p(uncertain) per vertex for each object.

    frame: from perception.load_frame, or several views of one scene, their T_world_camera in one world: what
    they saw adds up to one map. track: equal label numbers are the same object in all views; else they are
    where names agree too, and the rest is matched by place. config: see reconstruction.config.preset.
    seed: same seed, same meshes to the byte on one machine with the same number of threads (one and two count
    as the same), and from several Python threads at once. Objects that cannot be mapped are listed in
    `skipped`, with the reason. Raises FrameError when the frame shows no usable object, ConfigError for a
    negative seed.
    """
    import open3d  # noqa: F401  # loaded before the clock starts: its first import takes a second

    frames = (frame,) if isinstance(frame, Frame) else tuple(frame)
    if not frames:
        raise FrameError("no frame to map: the list of views is empty")
    if all(same_view(frames[0], other) for other in frames[1:]):
        frames = frames[:1]  # of one view there is nothing to join
    return _clocked(FittedScene.of(frames[0], config or PipelineConfig(), seed, frames[1:], track))


def update(
    result: Reconstruction,
    frame: Frame,
    track: bool = False,
    keep: int | None = None,
    config: PipelineConfig | None = None,
) -> Reconstruction:
    """The map of a scene with one view more; see Reconstruction.update. config: that of the result, where it
    is at hand."""
    import open3d  # noqa: F401

    config = config or pipeline_of(result.config)
    seen = result.observation
    known = seen.views if isinstance(seen, JointObservation) else (_first_view(result.frame, seen),)
    if keep is not None:
        if keep < 2:
            raise ConfigError(f"keep must be at least 2 views, got {keep}")
        known = without_the_least_new(known, keep - 1, frame.camera)
    joint = observe_together([frame], config.perception, result.seed, track, known)
    if [view.number for view in joint.views] == [view.number for view in known]:
        # The frame says nothing that is new, or may be believed: the map stays, and why is noted.
        if not any("contradicts" in note or "once more" in note for note in joint.notes):
            raise FrameError("; ".join(joint.notes) or f"{frame.source}: shows no object to map")
        return replace(result, notes=tuple(dict.fromkeys([*result.notes, *joint.notes])))
    numbers = {view.number for view in known}
    new = [view.observation for view in joint.views if view.number not in numbers]
    surfaces = _surfaces(result)
    shapes = seen.memo.get((SHAPES, config.mesh.fusion), {})
    left = seen.memo.get(LEFT, {})
    stay, lifted = _untouched(surfaces, new, config), seen.memo.get(LIFTED)
    before = Before(result.map, result.map_labels, surfaces, stay, shapes, left, lifted)
    scene = FittedScene(result.frame, config, generator(result.seed), result.seed, given=joint, before=before)
    updated = _clocked(scene)
    return replace(updated, notes=tuple(dict.fromkeys([*result.notes, *updated.notes])))


def _surfaces(result: Reconstruction) -> dict[int, Surface]:
    """The surfaces of all objects in the table frame, by label."""
    T_table_world = invert_rigid(result.T_world_table)
    fields = {field.label: field for field in result.fields}
    return {
        item.label: Surface(
            trimesh.Trimesh(
                transform(T_table_world, np.asarray(item.mesh.vertices)), item.mesh.faces, process=False
            ),
            item.uncertainty,
            fields.get(item.label),
            item,
        )
        for item in result.objects
    }


def _untouched(
    surfaces: Mapping[int, Surface], new: Sequence[Observation], config: PipelineConfig
) -> frozenset[int]:
    """Labels of objects that new views neither see nor look past: their surfaces stay."""
    return frozenset(
        label
        for label, surface in surfaces.items()
        if not any(touches(view, label, np.asarray(surface.mesh.vertices), config.perception) for view in new)
    )


def _first_view(frame: Frame, observation: Observation) -> View:
    """A single frame as the first of several views."""
    names = {item.label: item.name for item in observation.objects}
    view = View(*relabelled(frame, observation, {label: label for label in names}, names), 1)
    view.observation.memo.update(observation.memo)  # the same objects in the same places
    return view


def _clocked(scene: FittedScene) -> Reconstruction:
    """All steps of a scene, with the time that each took."""
    marks = [perf_counter()]
    for step in STAGES:
        getattr(scene, step)
        marks.append(perf_counter())
    result = deliver(scene)
    marks[-1] = perf_counter()  # placing the meshes in the world belongs to the last stage
    timings = {stage: 1e3 * (b - a) for stage, (a, b) in zip(STAGES.values(), pairwise(marks))}
    return replace(result, timings_ms={**timings, "total": 1e3 * (marks[-1] - marks[0])})


def deliver(scene: FittedScene) -> Reconstruction:
    """What a scene says of its objects, placed in the world frame. Raises DataError when it has none."""
    observation, frame = scene.observation, scene.shown
    T_world_table = frame.camera.T_world_camera @ np.linalg.inv(observation.T_table_camera)
    skipped, notes = list(observation.skipped), list(observation.notes)

    def place(index: int) -> tuple[ReconstructedObject, ObjectField, list[str]] | None:
        item, surface = observation.objects[index], scene.meshes[index]
        if surface is None:
            return None
        vertices = np.asarray(surface.mesh.vertices)
        field = surface.field or _object_field(scene.field, index, item, vertices)
        placed = _place(surface, item, index + 1, T_world_table)
        return placed, field, beyond_its_mesh(item, vertices)

    found = map_in_threads(place, range(len(observation.objects)))
    for item, one in zip(observation.objects, found):
        if one is None:
            skipped.append(Skipped(item.label, item.name, "the map gives it no volume at this resolution"))
        else:
            notes += one[2]
    objects = [one[0] for one in found if one is not None]
    fields = [one[1] for one in found if one is not None]
    if not objects:
        raise DataError(f"{frame.source}: no object has volume at a spacing of {scene.config.mesh.spacing} m")
    return Reconstruction(
        frame=frame,
        observation=observation,
        objects=tuple(objects),
        fields=tuple(fields),
        map=scene.map,
        T_world_table=T_world_table,
        samples=scene.samples.X,
        sample_classes=scene.samples.y.argmax(1),
        timings_ms={},
        skipped=tuple(skipped),
        notes=tuple(notes),
        config=scene.config.as_dict(),
        seed=scene.seed,
        floor=scene.floor,
        other=_other(scene, T_world_table),
        updater=partial(update, config=scene.config),
    )


def _other(scene: FittedScene, T_world_table: np.ndarray) -> OtherObstacles | None:
    """The obstacles without a label in the world frame."""
    surface, own = scene.other, scene.other_class
    if surface is None or own is None:
        return None
    vertices = transform(T_world_table, np.asarray(surface.mesh.vertices))
    mesh = trimesh.Trimesh(vertices, surface.mesh.faces, process=False)
    paint(mesh, surface.uncertainty)
    return OtherObstacles(mesh, surface.uncertainty, own)


def beyond_its_mesh(item: ObservedObject, vertices: np.ndarray) -> list[str]:
    """A line where measured points of an object lie well beyond its mesh's vertices (V, 3): in a part apart
    from the rest, of which so little was seen that it may be another thing's."""
    low, high = bounds(vertices)
    lowest, highest = item.bounds
    if max((low - lowest).max(), (highest - high).max()) <= WELL_BEYOND:
        return []
    off = np.maximum(np.maximum(low - item.points, item.points - high), 0).max(1)
    count = int(np.count_nonzero(off > WELL_BEYOND))
    if count < SEEN_POINTS:
        return []
    far = 1e3 * float(off.max())
    return [
        f"object {item.label} {item.name}: {count} measured points, up to {far:.0f} mm beyond its mesh, are "
        "not in it: too few of them, apart from the rest"
    ]


def _object_field(field: Field, index: int, item: ObservedObject, vertices: np.ndarray) -> ObjectField:
    """The lattice around one object, two nodes wider than its mesh."""
    low, high = bounds(vertices)
    around = window_of(field.origin, field.spacing, field.uncertainty.shape, low, high, pad=2)
    window = overlap(around, field.windows[index])
    odds = field.log_odds[index][within(window, field.windows[index])]
    occupancy = np.exp(-odds)
    occupancy += 1
    np.reciprocal(occupancy, out=occupancy)
    return ObjectField(
        label=item.label,
        origin=field.corner(window),
        spacing=field.spacing,
        occupancy=occupancy,
        uncertainty=field.uncertainty[window],
    )


def _place(
    surface: Surface, item: ObservedObject, class_index: int, T_world_table: np.ndarray
) -> ReconstructedObject:
    """The object in the world frame, with its upright box of least footprint."""
    if surface.placed is not None:  # where it was: nothing may move a surface that stays
        was = surface.placed
        mesh = trimesh.Trimesh(was.mesh.vertices, was.mesh.faces, process=False)
        paint(mesh, surface.uncertainty)
        return replace(was, class_index=class_index, mesh=mesh, uncertainty=surface.uncertainty)
    local = np.asarray(surface.mesh.vertices)
    T_table_object, extents = upright_box(local)
    mesh = trimesh.Trimesh(transform(T_world_table, local), surface.mesh.faces, process=False)
    paint(mesh, surface.uncertainty)
    return ReconstructedObject(
        label=item.label,
        name=item.name,
        class_index=class_index,
        mesh=mesh,
        uncertainty=surface.uncertainty,
        T_world_object=T_world_table @ T_table_object,
        extents=extents,
    )
