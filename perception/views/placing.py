"""One view in another's table frame, and under other labels. Knows one observation and rigid motions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

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
    seen = observation.seen
    if seen is not None:
        seen = np.where(seen > 0, table[np.maximum(seen, 0)].astype(seen.dtype), seen)
        seen = np.where((observation.seen > 0) & (seen == 0), seen.dtype.type(NOTHING), seen)  # type: ignore[operator]
    objects = tuple(
        replace(item, label=labels[item.label], name=names[labels[item.label]])
        for item in observation.objects
    )
    own = observation.labels if frame.labels is None else frame.labels
    # Numbers that cleaning made for further things of one label stand in its own image alone.
    given = np.where(table[own] > 0, own, observation.labels)
    given = np.where((observation.labels > 0) & (observation.labels != own), observation.labels, given)
    frame = frame.renamed({})
    object.__setattr__(frame, "labels", table[given])
    object.__setattr__(frame, "names", dict(names))
    return frame, replace(observation, labels=table[observation.labels], objects=objects, seen=seen)


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
