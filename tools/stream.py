"""`contramap stream`: frames of one scene in order, to one map that grows."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from mapping.errors import ConfigError, ContraMapError, DataError
from mapping.plain_json import plain
from perception.datasets.bags.config import NO_TOPICS, BagConfig
from reconstruction.config import TABLETOP, PipelineConfig, PresetName
from tools.options import pipeline_config, write_json

if TYPE_CHECKING:
    from perception.datasets.sequence import Shot
    from reconstruction.growing import GrowingMap, Taken
    from reconstruction.pictures.timeline import Timeline


def stream(
    frames: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FRAMES")],
    *,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    rrd: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    json: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    track: bool = False,
    keep: int = 8,
    depth_scale: Annotated[float | None, tyro.conf.arg(metavar="M")] = None,
    trust: tuple[Literal["unit", "kind", "K", "pose"], ...] = (),
    preset: PresetName = "tabletop",
    seed: int = 0,
    config: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    set: tuple[str, ...] = (),
    overwrite: bool = False,
    bag: BagConfig = NO_TOPICS,
    settings: Annotated[PipelineConfig, tyro.conf.arg(name="")] = TABLETOP,
) -> None:
    """Map the frames of one scene one after another; camera poses in one world.

    Example: contramap stream FRAMES --out grown
    Example: contramap stream run.bag --out grown --bag.every 0.5
    After each frame OUT is a result folder with the meshes of all frames so far; scene.json has the version
    and says what became of each frame. A stopped stream goes on when it is started again.

    Args:
        frames: Folder with one frame folder, .npz or organised cloud a frame, in the order of their names; or
            a frame with further ones in its views/, as `contramap scenes --views` makes them; or a ROS 1 or
            ROS 2 bag.
        out: Result folder; must be empty or absent, or hold an unfinished stream of the same frames and
            settings, or see --overwrite. Without it only figures are printed.
        rrd: Recording to write at the end; OUT/recording.rrd by default, where rerun is installed. It begins
            where this run began.
        json: Also write frames per second and what became of each frame to this file.
        track: Equal label numbers are the same object in all frames. Without it names must be equal too, and
            what has none is matched by where it is.
        keep: Views that the map is made of, at most: time and memory a frame stay as they are. Of more, the
            one taken nearest to another is forgotten.
        depth_scale: Metres per stored depth unit, where frames do not say it.
        trust: What you know to be right although it looks odd: unit, kind (z, not ray), K, pose.
        preset: tabletop (default) or paper.
        seed: Same seed, same meshes.
        config: YAML or JSON file of nested settings.
        set: Settings as text, such as mesh.spacing=0.003.
        overwrite: Replace an older result in --out.
        bag: Topics of a bag; those of one kind are found by themselves.
        settings: Every setting of the pipeline; the defaults are those of --preset.
    """
    from perception.datasets.bags.bag import shots_of_bag
    from perception.datasets.bags.opened import is_bag
    from perception.datasets.sequence import shots_in
    from reconstruction.growing import GrowingMap

    chosen = pipeline_config(settings, config, set)
    shots = shots_of_bag(frames, bag, trust) if is_bag(frames) else shots_in(frames, depth_scale, trust)
    if keep < 2:
        raise ConfigError(f"--keep must be at least 2 views, got {keep}")
    grown = GrowingMap(chosen, seed, track, keep)
    source = {"source": str(Path(frames).resolve()), "track": track, "keep": keep}
    target = Target(out, rrd, source, overwrite)
    target.check(grown)
    done = {one.name for one in grown.taken}
    todo = [shot for shot in shots if shot.name not in done]
    if done:
        print(f"{len(done)} frames were taken before: going on with version {grown.version}")
    if not todo:
        return
    target.take_up(grown)
    clock = Clock()
    try:
        _take(grown, todo, target, clock)
    finally:
        # What a stopped run has is kept whole, too.
        target.finish(grown)
    _report(grown, clock, target, json)


@dataclass
class Clock:
    """Seconds spent so far on each part of the work, and frames it was spent on."""

    seconds: dict[str, float] = field(default_factory=lambda: {"load": 0.0, "map": 0.0, "write": 0.0})
    frames: int = 0
    _mark: float = 0.0

    def start(self) -> None:
        """From now on."""
        self._mark = perf_counter()

    def lap(self, part: str) -> None:
        """What has passed since counts for a part."""
        now = perf_counter()
        self.seconds[part] += now - self._mark
        self._mark = now

    @property
    def total(self) -> float:
        return sum(self.seconds.values())


@dataclass
class Target:
    """Where a stream is written to: the result folder and the recording, either of which may be absent."""

    out: Path | None
    rrd: Path | None
    source: dict[str, Any]
    overwrite: bool
    timeline: Timeline | None = None
    changed: bool = False

    def check(self, grown: GrowingMap) -> None:
        """Raise ConfigError when something may not be written; read what became of the frames of an
        unfinished stream."""
        from reconstruction.files.output_folder import check_output
        from reconstruction.pictures.recording import check_recording

        if self.out is not None:
            if not self.overwrite and _unfinished(self.out, self.source, grown):
                self.overwrite = True
            check_output(self.out, self.overwrite)
        if self.rrd is not None:
            check_recording(self.rrd)

    def take_up(self, grown: GrowingMap) -> None:
        """Begin the recording, and map the frames that an unfinished stream kept."""
        from reconstruction import reconstruct
        from reconstruction.files.stored import load_result
        from reconstruction.files.stored_frame import read_views
        from reconstruction.pictures.timeline import Timeline

        if self.rrd is not None:
            self.timeline = Timeline()
        elif self.out is not None:
            with suppress(ConfigError):  # without rerun there is no recording
                self.timeline = Timeline()
        if self.out is not None and grown.version:
            views = read_views(self.out, len(load_result(self.out).scene.get("views", [None])))
            grown.result = reconstruct(views, grown.config, grown.seed, track=True)

    def write(self, grown: GrowingMap, whole: bool = False) -> None:
        """This version of the map, if it is new or wanted whole."""
        from reconstruction.files.result_folder import save_reconstruction

        self.changed = True
        if self.out is None or grown.result is None:
            return
        entry = {**self.source, **grown.describe()}
        save_reconstruction(grown.result, self.out, self.overwrite, stream=entry, whole=whole)
        self.overwrite = True  # what is there is this stream's own

    def finish(self, grown: GrowingMap) -> None:
        """The last version with all its files, and the recording."""
        from reconstruction.files.output_folder import RECORDING
        from reconstruction.files.recordings import name_recording

        if grown.result is None or not self.changed:
            return
        self.write(grown, whole=True)
        if self.timeline is not None:
            recording = self.rrd or (self.out or Path()) / RECORDING
            self.timeline.save(recording)
            if self.out is not None:
                name_recording(self.out, recording)


def _take(grown: GrowingMap, shots: Sequence[Shot], target: Target, clock: Clock) -> None:
    """Map frame after frame; a bad one is said and skipped, and the others go on."""
    from tqdm import tqdm

    before = len(grown.taken)
    for number, shot in enumerate(tqdm(shots, desc="frames", disable=None), before + 1):
        clock.start()
        try:
            frame = shot.load()
            clock.lap("load")
        except ContraMapError as error:
            taken = grown.skip(shot.name, error, shot.stamp)
        else:
            taken = grown.add(frame, shot.name, shot.stamp)
            clock.lap("map")
        if taken.skipped is None and grown.result is not None:
            target.write(grown)
            if target.timeline is not None:
                target.timeline.add(grown.result, frame, number, shot.stamp)
            clock.lap("write")
        clock.frames += 1
        tqdm.write(_line(taken))


def _line(taken: Taken) -> str:
    if taken.skipped is not None:
        return f"{taken.name}: skipped: {taken.skipped}"
    return (
        f"{taken.name}: version {taken.version}, {taken.objects} objects, mean p(uncertain) "
        f"{taken.uncertainty:.2f}"
    )


def _unfinished(out: Path, source: dict[str, Any], grown: GrowingMap) -> bool:
    """Whether a folder holds a stream of the same frames and settings; what became of them is taken up.
    Raises ConfigError when it holds another stream."""
    from reconstruction.files.output_folder import SCENE
    from reconstruction.files.stored import load_result

    if not (out / SCENE).is_file():
        return False
    scene = load_result(out).scene
    stored = scene.get("stream")
    if not isinstance(stored, dict):
        return False
    same = all(stored.get(key) == value for key, value in source.items()) and scene["seed"] == grown.seed
    if not same or scene["config"] != plain(grown.config.as_dict()):
        raise ConfigError(
            f"{out} holds a stream of other frames or settings ({stored.get('source')}); choose another "
            "folder or pass --overwrite"
        )
    grown.remember(stored)
    return True


def _report(grown: GrowingMap, clock: Clock, target: Target, json: Path | None) -> None:
    """Frames per second and what became of the frames, printed and as JSON. DataError when none could be
    used."""
    skipped = [one for one in grown.taken if one.skipped is not None]
    rate = clock.frames / clock.total if clock.total > 0 else 0.0
    figures = {
        "frames_per_second": rate,
        "mapped_now": clock.frames,
        "seconds": {**clock.seconds, "total": clock.total},
        **target.source,
        **grown.describe(),
    }
    write_json(plain(figures), json)
    if grown.result is None:
        raise DataError(f"none of {len(grown.taken)} frames could be mapped; the reasons are above")
    each = {part: 1e3 * value / max(clock.frames, 1) for part, value in clock.seconds.items()}
    parts = ", ".join(f"{part} {value:.0f}" for part, value in each.items())
    print(
        f"{clock.frames} frames in {clock.total:.1f} s: {rate:.2f} frames/s ({parts} ms a frame); "
        f"{len(skipped)} of {len(grown.taken)} skipped"
    )
    if target.out is not None:
        print(f"result: {target.out} (version {grown.version})")
