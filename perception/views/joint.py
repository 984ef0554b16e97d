"""Several views as one observation: their images lie one under the other, their points in one table frame.

Knows observations in one frame with one set of labels; knows nothing of how these were found to belong
together. A pixel's flat index counts in the stacked image, so what reads pixels of one image reads these.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from mapping.known_points import first_in_cells
from mapping.near_points import near_any
from perception.frame import Frame
from perception.observation import (
    NO_PIXELS,
    NOTHING,
    Observation,
    ObservedObject,
    OtherSurface,
    Skipped,
)

SAME_PLACE = 0.006
"""What is this near to a surface seen in another view is taken for that surface [m]."""


@dataclass(frozen=True)
class View:
    """One of several frames of a scene.

    frame: as it was given, its labels those of the joint observation; observation: the frame cleaned, in the
    joint table frame; number: which of the given frames it is, from 1.
    """

    frame: Frame
    observation: Observation
    number: int

    @property
    def labels(self) -> list[int]:
        """The labels of its objects, in their order."""
        return [item.label for item in self.observation.objects]


@dataclass(frozen=True)
class JointObservation(Observation):
    """What several views show together, in the table frame of the first.

    Images are those of all views, one under the other, padded to one width; pixels of objects count in them.
    They are put together when they are asked for: most steps ask the views. camera, T_table_camera and
    support are the first view's.
    """

    depth: np.ndarray = field(init=False, repr=False)
    labels: np.ndarray = field(init=False, repr=False)
    seen: np.ndarray | None = field(init=False, repr=False)
    views: tuple[View, ...] = ()

    def __getattr__(self, name: str) -> Any:
        if name not in ("depth", "labels", "seen"):
            raise AttributeError(name)
        seen = [view.observation for view in self.views]
        if name == "depth":
            image = self.stack.image([one.depth for one in seen], np.nan)
        elif name == "labels":
            image = self.stack.image([one.labels for one in seen], 0)
        else:
            bare = [
                np.full(one.depth.shape, NOTHING, np.int32) if one.seen is None else one.seen for one in seen
            ]
            image = self.stack.image(bare, NOTHING)
        self.__dict__[name] = image
        return image

    @cached_property
    def stack(self) -> Stack:
        """Where each view's image lies in the stacked one."""
        return Stack.of([view.observation.depth.shape for view in self.views])

    def shows_object(self, pixels: np.ndarray) -> np.ndarray:
        own = self.stack.view_of(pixels)
        found = np.zeros(len(pixels), bool)
        for number, view in enumerate(self.views):
            here = own == number
            found[here] = view.observation.shows_object(self.stack.taken(number, pixels[here]))
        return found & ~np.isin(pixels, self._no_guesses)

    @cached_property
    def _no_guesses(self) -> np.ndarray:
        """Pixels (M,) of surfaces that one view guessed and another measured."""
        guessed = [
            self.stack.place(number, item.guessed)
            for number, view in enumerate(self.views)
            for item in view.observation.objects
        ]
        return np.setdiff1d(np.concatenate(guessed), np.concatenate([item.guessed for item in self.objects]))

    @property
    def first(self) -> Observation:
        return self.views[0].observation

    def at_border(self, item: ObservedObject, within: int = 1) -> bool:
        """Whether no view shows an object whole."""
        return all(
            view.observation.at_border(own, within)
            for view in self.views
            for own in view.observation.objects
            if own.label == item.label
        )

    def thinned(self, label: int, size: float, views: Sequence[View] | None = None) -> np.ndarray:
        """The first point (M, 3) [m] measured of an object in each cell between multiples of `size` [m];
        views: what these measured, by default all. What a view leaves is worked out once."""
        parts = [np.empty((0, 3), np.float32)]
        for view in self.views if views is None else views:
            known = view.observation.memo.setdefault(("thinned", size), {})
            for item in view.observation.objects:
                if item.label == label:
                    if label not in known:
                        known[label] = item.points[first_in_cells(item.points, size)]
                    parts.append(known[label])
        points = np.concatenate(parts)
        return points[first_in_cells(points, size)] if len(parts) > 2 else points

    def columns(self, view: View) -> list[int]:
        """Where the objects of one view stand among all."""
        place = {item.label: index for index, item in enumerate(self.objects)}
        return [place[label] for label in view.labels]


@dataclass(frozen=True)
class Stack:
    """Where each view's image lies in the stacked one. width: of all; rows: first row of each view."""

    width: int
    rows: tuple[int, ...]
    widths: tuple[int, ...]

    @classmethod
    def of(cls, shapes: Sequence[tuple[int, ...]]) -> Stack:
        """Of images of shapes (H, W)."""
        heights, widths = zip(*shapes)
        return cls(max(widths), tuple(int(n) for n in np.cumsum([0, *heights[:-1]])), tuple(widths))

    def place(self, view: int, pixels: np.ndarray) -> np.ndarray:
        """Flat indices in the stacked image of pixels (N,) of one view; -1 stays -1."""
        if self.widths[view] == self.width:
            placed = pixels + self.rows[view] * self.width
        else:
            row, column = np.divmod(pixels, self.widths[view])
            placed = (row + self.rows[view]) * self.width + column
        return np.where(pixels < 0, pixels, placed).astype(pixels.dtype, copy=False)

    def taken(self, view: int, pixels: np.ndarray) -> np.ndarray:
        """Flat indices in one view's image of its pixels (N,) in the stacked one."""
        row, column = np.divmod(pixels, self.width)
        return (row - self.rows[view]) * self.widths[view] + column

    def view_of(self, pixels: np.ndarray) -> np.ndarray:
        """Which view pixels (N,) of the stacked image belong to."""
        return np.searchsorted(self.rows, pixels // self.width, side="right") - 1

    def image(self, images: Sequence[np.ndarray], missing: float) -> np.ndarray:
        """Images one under the other, padded with `missing`."""
        if len(set(self.widths)) == 1:
            return np.concatenate(images)
        padded = [
            np.pad(image, ((0, 0), (0, self.width - image.shape[1])), constant_values=missing)
            for image in images
        ]
        return np.concatenate(padded)


def join(views: Sequence[View], notes: Sequence[str], skipped: Sequence[Skipped] = ()) -> JointObservation:
    """One observation of views that share a table frame and labels."""
    seen = [view.observation for view in views]
    stack = Stack.of([one.depth.shape for one in seen])
    labels = dict.fromkeys(label for view in views for label in view.labels)
    objects = tuple(_merged(label, seen, stack) for label in labels)
    floors = {item.label: item.floor for item in objects}
    placed = tuple(replace(view, observation=_on_floors(view.observation, floors)) for view in views)
    guesses = [one.guess for one in seen]
    guess = None
    if any(one is not None for one in guesses):
        empty = [np.full(one.depth.shape, np.float32(np.nan)) for one in seen]
        guess = stack.image([e if g is None else g for g, e in zip(guesses, empty)], np.nan)
    first = seen[0]
    heights = {*first.levels, *(item.floor for item in objects)}
    return JointObservation(
        first.camera,
        first.T_table_camera,
        first.support,
        objects,
        tuple(skipped),
        tuple(notes),
        levels=tuple(sorted(heights)),
        other=_obstacles(objects, seen, stack),
        guess=guess,
        views=placed,
    )


def _merged(label: int, seen: Sequence[Observation], stack: Stack) -> ObservedObject:
    """One object as all views show it. What one view guessed and another measured is no guess any more."""
    own = [(index, item) for index, one in enumerate(seen) for item in one.objects if item.label == label]
    first = own[0][1]
    points = np.concatenate([item.points for _, item in own])
    guessed = np.concatenate([stack.place(index, item.guessed) for index, item in own])
    places = np.concatenate([item.guessed_points for _, item in own])
    if len(guessed) and len(own) > 1:
        unseen = ~near_any(places, points, SAME_PLACE)
        guessed, places = guessed[unseen], places[unseen]
    resting = next((item for _, item in own if item.rests), first)
    return ObservedObject(
        label,
        next((item.name for _, item in own if item.name != f"object_{label}"), first.name),
        points,
        np.concatenate([stack.place(index, item.pixels) for index, item in own]),
        sum(item.labelled for _, item in own),
        sum(item.dropped for _, item in own),
        resting.floor,
        resting.rests,
        np.concatenate([NO_PIXELS, *(stack.place(index, item.silhouette) for index, item in own)]),
        guessed,
        places,
    )


def _on_floors(observation: Observation, floors: dict[int, float]) -> Observation:
    """The same with every object on the floor that all views agree on; itself where they are already."""
    if all(item.floor == floors[item.label] for item in observation.objects):
        return observation
    return replace(
        observation,
        objects=tuple(replace(item, floor=floors[item.label]) for item in observation.objects),
    )


def _obstacles(objects: Sequence[ObservedObject], seen: Sequence[Observation], stack: Stack) -> OtherSurface:
    """Obstacles of all views, but for what another view knows to be an object."""
    points = np.concatenate([one.other.points for one in seen])
    pixels = np.concatenate([stack.place(index, one.other.pixels) for index, one in enumerate(seen)])
    bulky = np.concatenate([one.other.bulky for one in seen])
    if len(points):
        kept = ~near_any(points, np.concatenate([item.points for item in objects]), SAME_PLACE)
        points, pixels, bulky = points[kept], pixels[kept], bulky[kept]
    return OtherSurface(points, pixels, bulky)
