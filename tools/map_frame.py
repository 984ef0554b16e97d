"""`contramap map`: one frame to a result folder, or many frames to one each."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from mapping.errors import ConfigError
from perception.datasets.bags.config import NO_TOPICS, BagConfig
from reconstruction.config import TABLETOP, PipelineConfig, PresetName
from tools.frame_source import FrameSource
from tools.map_many import map_all, result_folders
from tools.options import pipeline_config

if TYPE_CHECKING:
    from reconstruction.result import Reconstruction


def map_frame(
    frame: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="FRAME")] = (),
    *,
    out: Path,
    rgb: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    depth: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    labels: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    intrinsics: Annotated[
        tuple[float, float, float, float] | None, tyro.conf.arg(metavar="FX FY CX CY")
    ] = None,
    camera: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    pose: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    depth_scale: Annotated[float | None, tyro.conf.arg(metavar="M")] = None,
    bop: Annotated[tuple[Path, int, int] | None, tyro.conf.arg(metavar="DIR SCENE IMAGE")] = None,
    at: Annotated[float | None, tyro.conf.arg(metavar="SECONDS")] = None,
    trust: tuple[Literal["unit", "kind", "K", "pose"], ...] = (),
    preset: PresetName = "tabletop",
    prior: str | None = None,
    device: str | None = None,
    seed: int = 0,
    spacing: Annotated[float | None, tyro.conf.arg(metavar="M")] = None,
    max_uncertainty: Annotated[float | None, tyro.conf.arg(metavar="U")] = None,
    config: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    set: tuple[str, ...] = (),
    rrd: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    together: bool = False,
    track: bool = False,
    overwrite: bool = False,
    bag: BagConfig = NO_TOPICS,
    settings: Annotated[PipelineConfig, tyro.conf.arg(name="")] = TABLETOP,
) -> None:
    """Map an RGB-D frame: one watertight metric mesh with uncertainty per object.

    Example: contramap map FRAME --out result --rrd run.rrd
    Several frames go to one folder each, in one process: contramap map FRAME FRAME ... --out results
    Several views of one scene go to one map: contramap map FRAME FRAME ... --together --out result

    Args:
        frame: Frame folder (rgb.png, depth.png or depth.npy, labels.png or masks/, camera.json or a ROS or
            RealSense camera file), .npz file, or organised .pcd or .ply cloud; see docs/inputs.md.
        out: Result folder; must be empty or absent, or see --overwrite. With several frames, the folder of
            the results' folders, named as the frames are.
        rgb: Colour image, instead of FRAME.
        depth: Depth image, instead of FRAME: 16-bit PNG or TIFF, float TIFF, EXR, or .npy.
        labels: Instance labels, 0 = background: an image, .npy, COCO JSON, or a folder of masks; without them
            the depth is segmented.
        intrinsics: Focal lengths and principal point [px], with --depth.
        camera: Camera file instead of --intrinsics: ROS camera_info, RealSense, Open3D, BOP, or K alone.
        pose: File with the camera's pose in the world: 4x4, x y z qx qy qz qw, or position and orientation.
        depth_scale: Metres per stored depth unit; with --depth 0.001 (millimetres) by default.
        bop: One image of a data set in BOP's layout, instead of FRAME: split folder, scene and image number.
        at: With a ROS 1 or ROS 2 bag as FRAME: of its depth images the one nearest to this time, counted from
            the first one on or since 1970; the first one by default.
        trust: What you know to be right although it looks odd: unit, kind (z, not ray), K, pose.
        preset: tabletop (default) or paper (samples and hinge points as published).
        prior: What guesses hidden shapes: learned, or none (samples.prior; the paper preset has none).
        device: cpu, cuda or auto (map.device).
        seed: Same seed, same meshes, for one thread or two, and for each larger number (OMP_NUM_THREADS).
        spacing: Lattice spacing of the meshes [m] (mesh.spacing).
        max_uncertainty: Keep only what is less uncertain than this, 0..1 (mesh.max_uncertainty).
        config: YAML or JSON file of nested settings, as in the `config` of a scene.json.
        set: Settings as text, such as mesh.spacing=0.003; the same as --mesh.spacing 0.003.
        rrd: Also write a rerun recording to this file; `contramap view RESULT` finds it.
        together: The frames are views of one scene, their camera poses in one world: map them as one.
        track: With --together: equal label numbers are the same object in all views. Without it names must be
            equal too, and what has none is matched by where it is.
        overwrite: Replace an older result in --out.
        bag: Topics of a bag; those of one kind are found by themselves. See --at.
        settings: Every setting of the pipeline; the defaults are those of --preset.
    """
    from perception.frame_io import load_frame
    from reconstruction import reconstruct
    from reconstruction.files.result_folder import check_output, save_reconstruction

    chosen = pipeline_config(settings, config, set, device, prior, spacing, max_uncertainty)
    given = rgb or depth or labels or intrinsics or camera or pose or bop or at is not None
    if len(frame) > 1 and (given or (rrd and not together)):
        raise ConfigError("several frames go with --out and settings only; map one at a time otherwise")
    if (together or track) and len(frame) < 2:
        raise ConfigError("--together needs several frames: contramap map FRAME FRAME ... --together")
    if track and not together:
        raise ConfigError("--track goes with --together: views of one scene")
    if len(frame) > 1 and not together:
        folders = result_folders(frame, out)
        for folder in folders:
            check_output(folder, overwrite)

        def map_one(path: Path, folder: Path) -> None:
            loaded = load_frame(path, depth_scale=depth_scale, trust=trust)
            save_reconstruction(reconstruct(loaded, chosen, seed), folder, overwrite=overwrite)

        map_all(frame, folders, map_one)
        return
    check_output(out, overwrite)
    if rrd is not None:
        from reconstruction.pictures.recording import check_recording

        check_recording(rrd)
    if together:
        views = [load_frame(path, depth_scale=depth_scale, trust=trust) for path in frame]
        reconstruction = reconstruct(views, chosen, seed, track)
    else:
        one = frame[0] if frame else None
        source = FrameSource(one, rgb, depth, labels, intrinsics, camera, pose, depth_scale, bop, trust)
        source = replace(source, at=at, topics=bag)
        reconstruction = reconstruct(source.load(), chosen, seed)
    save_reconstruction(reconstruction, out, overwrite=overwrite)
    if rrd is not None:
        from reconstruction.files.recordings import name_recording
        from reconstruction.pictures.recording import record

        record(reconstruction, rrd)
        name_recording(out, rrd)
    print_summary(reconstruction)
    print(f"result: {out}")


def print_summary(reconstruction: Reconstruction) -> None:
    """Objects, what was skipped, notes and stage timings, for people."""
    from reconstruction.files.trust import object_notes

    head = "uncertainty  watertight  labelled  measured  agreeing  support"
    print(f"{'label':>5}  {'name':28} {'size [mm]':>15}  {head}")
    seen = {item.label: item for item in reconstruction.observation.objects}
    supported = reconstruction.observation.support is not None
    for item in reconstruction.objects:
        size = " x ".join(f"{1000 * side:.0f}" for side in item.extents)
        tight = "yes" if item.watertight else "NO"
        own = seen[item.label]
        support = f"{1000 * own.floor:+.0f} mm" if supported else "none"
        agreeing = f"{reconstruction.agreement[item.label].agreement:.0%}"
        print(
            f"{item.label:>5}  {item.name:28.28} {size:>15}  {item.mean_uncertainty:11.2f}  {tight:10}  "
            f"{own.labelled:>8}  {len(own.pixels):>8}  {agreeing:>8}  {support:>7}"
        )
    if reconstruction.other is not None:
        count = len(reconstruction.observation.other.pixels)
        print(f"other  obstacles without a label near the objects: {count} measured pixels")
    for item in reconstruction.objects:
        if notes := object_notes(item, reconstruction):
            print(f"note: {item.label} {item.name}: {'; '.join(notes)}")
    for skipped in reconstruction.skipped:
        print(f"skipped {skipped.label} {skipped.name}: {skipped.reason}")
    for note in [*reconstruction.notes, *reconstruction.contradictions]:
        print(f"note: {note}")
    stages = ", ".join(f"{stage} {ms:.0f}" for stage, ms in reconstruction.timings_ms.items())
    print(f"milliseconds: {stages}")
