"""Several frames of one scene to one observation: each cleaned by itself, then placed, matched and joined.

Knows frames with camera poses in one world; knows nothing of maps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mapping.errors import FrameError
from perception.camera import invert_rigid
from perception.config import PerceptionConfig
from perception.frame import Frame
from perception.observation import Observation, Skipped
from perception.observing import observe
from perception.space import Space
from perception.views.disagreement import Left, contradictions, pixels_at, to_leave_out
from perception.views.joint import JointObservation, View, join
from perception.views.matching import match
from perception.views.placing import moved, relabelled, without_pixels
from perception.views.repeated import same_view


def observe_together(
    frames: Sequence[Frame],
    config: PerceptionConfig | None = None,
    seed: int = 0,
    track: bool = False,
    known: Sequence[View] = (),
    ordered: bool = False,
) -> JointObservation:
    """Clean frames of one scene and express them in the table frame of one that shows a support.

    track: equal label numbers are the same object in all frames; else names must agree too, or the place
    decides. known: views of the scene that were observed before; their labels and table frame stay. ordered:
    the first frame leads; by default the poses decide, so that the order of frames changes nothing. Views
    that contradict the others, or are another one once more, are left out, and named in the notes. Raises
    FrameError when no frame shows an object.
    """
    config = config or PerceptionConfig()
    kept = [(view.number, view.frame, view.observation) for view in known]
    notes = []
    last = max((view.number for view in known), default=0)
    for number, frame in enumerate(frames, last + 1):
        twin = next((other for other, given, _ in kept if same_view(given, frame)), None)
        if twin is not None:
            notes.append(f"view {number}: left out: it is view {twin} once more")
            continue
        try:
            kept.append((number, frame, observe(frame, config, seed)))
        except FrameError as error:
            notes.append(f"view {number}: left out: {error}")
    if not kept:
        raise FrameError("no view shows an object to map (" + "; ".join(notes) + ")")
    poses = [frame.camera.T_world_camera for _, frame, _ in kept]
    if len(poses) > 1 and all(np.array_equal(pose, poses[0]) for pose in poses):
        notes.append("all views have one camera pose: is T_world_camera missing?")
    settled = len(known)
    while True:
        ranks = [_rank(*entry[1:], ordered or settled > 0) for entry in kept]
        lead = min(range(len(kept)), key=lambda index: ranks[index])
        views, found = _placed(kept, kept[0 if settled else lead], config, track, settled)
        agreeing, left = _agreeing(views, config, settled)
        there = {view.number for view in agreeing}
        if settled or kept[lead][0] in there:
            break
        # All places were those of a view that is wrong.
        notes += [line for line in left if line.startswith(f"view {kept[lead][0]} ")]
        del kept[lead]
    for view in views:
        if view.number > last:
            notes += [f"view {view.number}: {note}" for note in view.observation.notes]
    if not settled:
        rank = {entry[0]: own for entry, own in zip(kept, ranks)}
        agreeing.sort(key=lambda view: rank[view.number])
    skipped = _skipped(kept, {label for view in agreeing for label in view.labels})
    return join(agreeing, [*notes, *found, *left], skipped)


def _rank(frame: Frame, observation: Observation, ordered: bool) -> tuple[float, ...]:
    """Views of the least rank come first: those with a support, then by pose unless they are ordered."""
    pose = () if ordered else tuple(frame.camera.T_world_camera[:3].round(6).ravel().tolist())
    return (float(observation.support is None), *pose)


def _placed(
    kept: Sequence[tuple[int, Frame, Observation]],
    lead: tuple[int, Frame, Observation],
    config: PerceptionConfig,
    track: bool,
    settled: int,
) -> tuple[list[View], list[str]]:
    """All views in the table frame of one of them, under joint labels, and how these were found."""
    T_world_table = lead[1].camera.T_world_camera @ np.linalg.inv(lead[2].T_table_camera)
    to_table = np.linalg.inv(T_world_table)
    placed = [
        # Views that are settled are in the table frame already, and stay the same objects.
        observation
        if number < settled
        else moved(observation, to_table @ frame.camera.T_world_camera, lead[2].levels)
        for number, (_, frame, observation) in enumerate(kept)
    ]
    spaces = [Space.of(one, config) for one in placed]
    numbers, frames = [entry[0] for entry in kept], [entry[1] for entry in kept]
    labels, found = match(frames, placed, spaces, track, numbers, settled)
    return _views(kept, placed, labels, settled), found


def observe_again(
    frames: Sequence[Frame], config: PerceptionConfig, seed: int, T_world_table: np.ndarray
) -> Observation:
    """The observation behind a map that was made before, from its views as they were kept with it.

    Their labels were cleaned once already; the map's own table frame is the one that counts.
    """
    to_table = invert_rigid(T_world_table)
    if len(frames) == 1:
        observation = observe(frames[0], config, seed)
        return replace(observation, T_table_camera=to_table @ frames[0].camera.T_world_camera)
    joint = observe_together(frames, config, seed, track=True, ordered=True)
    views = tuple(
        replace(
            view,
            observation=replace(view.observation, T_table_camera=to_table @ view.frame.camera.T_world_camera),
        )
        for view in joint.views
    )
    return replace(joint, T_table_camera=views[0].observation.T_table_camera, views=views)


def _views(
    kept: Sequence[tuple[int, Frame, Observation]],
    placed: Sequence[Observation],
    labels: Sequence[dict[int, int]],
    settled: int = 0,
) -> list[View]:
    """Views under their joint labels; an object has the name that it has where it is met first. Settled ones
    have these already."""
    names: dict[int, str] = {}
    for (_, frame, _), own in zip(kept, labels):
        for old, new in own.items():
            if old in frame.names:
                names.setdefault(new, frame.names[old])
    for own in labels:
        for new in own.values():
            names.setdefault(new, f"object_{new}")
    views = []
    for index, ((number, frame, _), observation, own) in enumerate(zip(kept, placed, labels)):
        if index < settled:
            views.append(View(frame, observation, number))
            continue
        given, renamed = relabelled(frame, observation, own, names)
        views.append(View(given, renamed, number))
    return views


def _agreeing(views: list[View], config: PerceptionConfig, settled: int = 0) -> tuple[list[View], list[str]]:
    """The views, or parts of them, that do not contradict most others, and a line for what was left out.
    settled: so many of them were found to agree before."""
    if len(views) == 1:
        return views, []
    spaces = [Space.of(view.observation, config) for view in views]
    left = to_leave_out(contradictions(views, spaces, config, settled), [view.labels for view in views])
    whole = {entry.view for entry in left if entry.label is None}
    notes = [_line(entry, views) for entry in left]
    kept = []
    for index, view in enumerate(views):
        if index in whole:
            continue
        for entry in left:
            if entry.view == index and entry.label is not None:
                view = _without_object(view, entry.label, spaces[index], views, whole)
        if view.observation.objects:
            kept.append(view)
    if not kept:
        raise FrameError("the views contradict each other everywhere: are their poses of one world?")
    return kept, notes


def _without_object(view: View, label: int, space: Space, views: Sequence[View], whole: set[int]) -> View:
    """A view that says nothing of one object."""
    others = [
        item.points
        for index, other in enumerate(views)
        if index not in whole and other.number != view.number
        for item in other.observation.objects
        if item.label == label
    ]
    own = next((item for item in view.observation.objects if item.label == label), None)
    places = np.concatenate([np.empty((0, 3), np.float32), *others])
    observation, frame = without_pixels(view.observation, view.frame, pixels_at(space, own, places))
    return View(frame, observation, view.number)


def _line(entry: Left, views: Sequence[View]) -> str:
    """What is said of something that is left out."""
    view = views[entry.view]
    tie = "; which of two views is right cannot be told, the first is kept" if len(views) == 2 else ""
    if entry.label is None:
        return (
            f"view {view.number} ({view.frame.source}) contradicts the others: its pose or time is another "
            f"({entry.share:.0%} of an object's points lie where other views see through); left out{tie}"
        )
    name = next(
        item.name for other in views for item in other.observation.objects if item.label == entry.label
    )
    return (
        f"view {view.number} contradicts the others about {entry.label} {name}: moved, or its mask is wrong "
        f"({entry.share:.0%} of its points lie where other views see through); left out there{tie}"
    )


def _skipped(kept: Sequence[tuple[int, Frame, Observation]], mapped: set[int]) -> list[Skipped]:
    """Objects that no view could use."""
    found: dict[int, Skipped] = {}
    for number, _, observation in kept:
        for item in observation.skipped:
            if item.label not in mapped:
                reason = f"view {number}: {item.reason}"
                found.setdefault(item.label, Skipped(item.label, item.name, reason))
    return list(found.values())
