"""From one RGB-D frame to metric meshes with uncertainty: the pipeline, top to bottom."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter

import numpy as np

from mapping.contramap import ContraMap
from mapping.errors import DataError
from perception.camera import transform
from perception.frame import Frame
from perception.observation import Observation, ObservedObject, Skipped
from perception.observe import observe
from perception.space import Space
from reconstruction.config import PipelineConfig
from reconstruction.result import ObjectField, ReconstructedObject, Reconstruction
from reconstruction.surface.field import Field, evaluate_field, overlap, window_of, within
from reconstruction.surface.meshing import extract_mesh


def reconstruct(frame: Frame, config: PipelineConfig | None = None, seed: int = 0) -> Reconstruction:
    """Map a frame: one watertight mesh [m, world frame] with p(uncertain) per vertex for each object.

    frame: from perception.load_frame. config: see reconstruction.config.preset. seed: same seed, same
    meshes to the byte on one machine. Objects that cannot be mapped are listed in `skipped`, with the
    reason. Raises FrameError when the frame shows no usable object.
    """
    import open3d  # noqa: F401  # loaded before the clock starts: its first import takes a second

    config = config or PipelineConfig()
    timings: dict[str, float] = {}
    rng = np.random.default_rng(seed)

    with _timed(timings, "observe"):
        observation = observe(frame, config.perception, seed)
    with _timed(timings, "space"):
        space = Space.of(observation)
    with _timed(timings, "samples"):
        training = config.samples.draw(observation, space, rng)
    with _timed(timings, "fit"):
        model = ContraMap(config.map).fit(
            training.X, training.y, hinges=training.hinges, gamma=training.gamma
        )
    with _timed(timings, "field"):
        lows, highs = object_space(observation, config.mesh.margin)
        floor = object_floor(observation, config)
        field = evaluate_field(model, lows, highs, config.mesh.spacing, floor, config.mesh.confined)
    T_world_table = frame.camera.T_world_camera @ np.linalg.inv(observation.T_table_camera)
    objects: list[ReconstructedObject] = []
    fields: list[ObjectField] = []
    skipped = list(observation.skipped)
    with _timed(timings, "mesh"):
        for index, item in enumerate(observation.objects):
            extracted = extract_mesh(field, index, config.mesh, item.points)
            if extracted is None:
                skipped.append(
                    Skipped(item.label, item.name, "the map gives it no volume at this resolution")
                )
                continue
            mesh, uncertainty = extracted
            fields.append(_object_field(field, index, item, mesh.bounds))
            objects.append(_place(mesh, uncertainty, item, index + 1, T_world_table))
    if not objects:
        raise DataError(f"{frame.source}: no object has volume at a spacing of {config.mesh.spacing} m")
    timings["total"] = sum(timings.values())
    return Reconstruction(
        frame=frame,
        observation=observation,
        objects=tuple(objects),
        fields=tuple(fields),
        map=model,
        T_world_table=T_world_table,
        samples=training.X,
        sample_classes=training.y.argmax(1),
        timings_ms=timings,
        skipped=tuple(skipped),
        notes=observation.notes,
        config=config.as_dict(),
        seed=seed,
        floor=floor,
    )


@contextmanager
def _timed(timings: dict[str, float], stage: str) -> Iterator[None]:
    start = perf_counter()
    yield
    timings[stage] = (perf_counter() - start) * 1e3


def object_space(observation: Observation, margin: float) -> tuple[np.ndarray, np.ndarray]:
    """Boxes (K, 3), (K, 3) [m] in the table frame that hold every place where an object can be.

    What is hidden of an object reaches no further than `margin` beyond what is seen of it.
    """
    lows, highs = (np.array(b) for b in zip(*(o.bounds for o in observation.objects)))
    lows, highs = lows - margin, highs + margin
    if observation.support is not None:
        lows[:, 2] = np.maximum(lows[:, 2], -0.02)
    return lows, highs


def object_floor(observation: Observation, config: PipelineConfig) -> float | None:
    """Height [m] in the table frame below which no object can be; None when no support was found."""
    return config.mesh.floor if observation.support is not None else None


def _object_field(field: Field, index: int, item: ObservedObject, bounds: np.ndarray) -> ObjectField:
    """The lattice around one object, two nodes wider than its mesh."""
    low, high = bounds
    around = window_of(field.origin, field.spacing, field.uncertainty.shape, low, high, pad=2)
    window = overlap(around, field.windows[index])
    odds = field.log_odds[index][within(window, field.windows[index])]
    return ObjectField(
        label=item.label,
        origin=field.corner(window),
        spacing=field.spacing,
        occupancy=(1 / (1 + np.exp(-odds))).astype(np.float32),
        uncertainty=field.uncertainty[window],
    )


def _place(mesh, uncertainty, item: ObservedObject, class_index: int, T_world_table) -> ReconstructedObject:
    """The object in the world frame, with its upright box of least footprint."""
    T_table_object, extents = upright_box(np.asarray(mesh.vertices))
    mesh.vertices = transform(T_world_table, np.asarray(mesh.vertices))
    return ReconstructedObject(
        label=item.label,
        name=item.name,
        class_index=class_index,
        mesh=mesh,
        uncertainty=uncertainty,
        T_world_object=T_world_table @ T_table_object,
        extents=extents,
    )


def upright_box(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pose (4, 4) and size (3,) of the smallest box around points (V, 3) whose z axis stays vertical."""
    import cv2

    (x, y), (width, depth), degrees = cv2.minAreaRect(points[:, :2].astype(np.float32))
    bottom, top = points[:, 2].min(), points[:, 2].max()
    angle = np.radians(degrees)
    T = np.eye(4)
    T[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    T[:3, 3] = [x, y, (bottom + top) / 2]
    return T, np.array([width, depth, top - bottom])
