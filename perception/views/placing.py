"""One view in another's table frame, and under other labels. Knows one observation and rigid motions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mapping.compiled import compiled
from perception.camera import transform
from perception.frame import Frame
from perception.observation import NOTHING, Observation, ObservedObject

SAME_LEVEL = 0.008
"""Supports whose heights differ by no more than this between views are one [m]."""


def moved(observation: Observation, T_table_camera: np.ndarray, levels: tuple[float, ...]) -> Observation:
    """The same observation in another table frame. levels: heights [m] of the supports known there, which
    objects that stand as high are taken to stand on."""
    T = T_table_camera @ np.linalg.inv(observation.T_table_camera)
    objects = tuple(_moved(item, T, levels) for item in observation.objects)
    other = replace(observation.other, points=transform(T, observation.other.points))
    return replace(observation, T_table_camera=T_table_camera, objects=objects, other=other)


def _moved(item: ObservedObject, T: np.ndarray, levels: tuple[float, ...]) -> ObservedObject:
    """One object in another frame, where T (4, 4) leads to."""
    foot = np.append(item.points[:, :2].mean(0), item.floor)
    height = float(transform(T, foot)[2])
    nearest = min(levels, key=lambda level: abs(level - height))
    return replace(
        item,
        points=transform(T, item.points),
        guessed_points=transform(T, item.guessed_points),
        floor=nearest if abs(nearest - height) <= SAME_LEVEL else height,
    )


def relabelled(
    frame: Frame, observation: Observation, labels: Mapping[int, int], names: Mapping[int, str]
) -> tuple[Frame, Observation]:
    """The same view with other label numbers: labels maps each object's own to the new one. names: of the
    new ones. What carried another label carries none."""
    table = np.zeros(1 << 16, np.uint16)
    for old, new in labels.items():
        table[old] = new
    seen = None if observation.seen is None else _renumbered(observation.seen, table)
    objects = tuple(
        replace(item, label=labels[item.label], name=names[labels[item.label]])
        for item in observation.objects
    )
    own = observation.labels if frame.labels is None else frame.labels
    given, cleaned = _relabelled(own, observation.labels, table)
    frame = frame.renamed({})
    object.__setattr__(frame, "labels", given)
    object.__setattr__(frame, "names", dict(names))
    return frame, replace(observation, labels=cleaned, objects=objects, seen=seen)


@compiled
def _renumbered(seen: np.ndarray, table: np.ndarray) -> np.ndarray:
    """What pixels (H, W) see under new numbers: NOTHING where a label has none."""
    found = seen.copy()
    for row in range(seen.shape[0]):
        for column in range(seen.shape[1]):
            if seen[row, column] > 0:
                number = table[seen[row, column]]
                found[row, column] = number if number > 0 else NOTHING
    return found


@compiled
def _relabelled(own: np.ndarray, cleaned: np.ndarray, table: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Labels (H, W) as they were given, and cleaned ones, under new numbers. Numbers that cleaning made for
    further things of one label stand in its own image alone."""
    given, others = np.empty(own.shape, table.dtype), np.empty(own.shape, table.dtype)
    for row in range(own.shape[0]):
        for column in range(own.shape[1]):
            first, second = own[row, column], cleaned[row, column]
            others[row, column] = table[second]
            if table[first] == 0 or (second > 0 and second != first):
                first = second
            given[row, column] = table[first]
    return given, others


def without_pixels(observation: Observation, frame: Frame, pixels: np.ndarray) -> tuple[Observation, Frame]:
    """The same view as if flat pixels (N,) had measured nothing; objects that saw them lose them."""
    gone = np.zeros(observation.depth.size, bool)
    gone[pixels] = True
    image = gone.reshape(observation.depth.shape)
    nothing = np.float32(np.nan)
    objects = []
    for item in observation.objects:
        kept, guessed = ~gone[item.pixels], ~gone[item.guessed]
        if kept.any():
            objects.append(
                replace(
                    item,
                    points=item.points[kept],
                    pixels=item.pixels[kept],
                    guessed=item.guessed[guessed],
                    guessed_points=item.guessed_points[guessed],
                    silhouette=item.silhouette[~gone[item.silhouette]],
                )
            )
    other = observation.other
    left = ~gone[other.pixels]
    blind = replace(
        observation,
        depth=np.where(image, nothing, observation.depth),
        labels=np.where(image, observation.labels.dtype.type(0), observation.labels),
        objects=tuple(objects),
        other=replace(other, points=other.points[left], pixels=other.pixels[left], bulky=other.bulky[left]),
        seen=None if observation.seen is None else np.where(image, np.int32(NOTHING), observation.seen),
        guess=None if observation.guess is None else np.where(image, nothing, observation.guess),
    )
    masked = frame.renamed({})
    object.__setattr__(masked, "depth", np.where(image, nothing, frame.depth))
    if frame.labels is not None:
        object.__setattr__(masked, "labels", np.where(image, frame.labels.dtype.type(0), frame.labels))
    return blind, masked
