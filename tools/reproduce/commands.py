"""`contramap reproduce toy | occupancy | semantic | hinges`: the paper's experiments."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import tyro

from mapping.errors import ConfigError
from mapping.files import write_atomically
from tools.options import write_json
from tools.provenance import with_provenance

JsonFile = Annotated[Path | None, tyro.conf.arg(metavar="FILE")]


def toy(
    *,
    out: Path,
    sets: tuple[str, ...] = (),
    methods: tuple[str, ...] = (),
    seed: int = 0,
    repeats: int = 5,
    overwrite: bool = False,
    json: JsonFile = None,
) -> None:
    """Uncertainty of six methods on Two Ovals, Two Moons and Two Circles: the paper's figure, and a table.

    Example: contramap reproduce toy --out toy_out --json toy.json

    Args:
        out: Folder for runs, table and figure; a command that was cut off goes on there.
        sets: two_ovals, two_moons, two_circles; all when left out.
        methods: gp, mc_dropout, deep_ensemble, dnn_gp, sngp, contramap; all when left out.
        seed: First seed.
        repeats: Number of seeds.
        overwrite: Compute again what is there already.
        json: Also write the figures to this file.
    """
    from tools.reproduce.toy import TOY_SETS, run_toy, toy_table
    from tools.reproduce.toy_methods import METHODS

    summary = run_toy(out, sets or TOY_SETS, methods or METHODS, _seeds(seed, repeats), overwrite=overwrite)
    _report(summary, "Toy sets", toy_table(summary), out, out / "uncertainty.png", json)


def occupancy(
    *,
    data: Path,
    out: Path,
    logs: tuple[str, ...] = (),
    methods: tuple[str, ...] = (),
    seed: int = 0,
    repeats: int = 3,
    held_out_run: int = 1,
    keep_every_sample: bool = False,
    overwrite: bool = False,
    json: JsonFile = None,
) -> None:
    """Occupancy maps of the Radish laser logs: Hilbert map, Bayesian Hilbert map and ContraMap.

    The Bayesian Hilbert map takes minutes to an hour a log and seed; leave it out with --methods.

    Example: contramap reproduce occupancy --data ../shared/data/radish --methods hilbert contramap --out occ

    Args:
        data: Folder of CARMEN logs, such as intel-corrected.log.gz.
        out: Folder for runs, table and figures; a command that was cut off goes on there.
        logs: belgioioso, edmonton, fhw, intel, mexico, aces, orebro, seattle; all when left out.
        methods: hilbert, contramap, bayesian_hilbert, and bayesian_hilbert_merged, which learns from merged
            samples as the first two do; all when left out.
        seed: First seed.
        repeats: Number of seeds.
        held_out_run: Consecutive scans that are held out together; 1 splits at random.
        keep_every_sample: Do not merge samples before training.
        overwrite: Compute again what is there already.
        json: Also write the figures to this file.
    """
    from tools.reproduce.landscape import LANDSCAPES
    from tools.reproduce.occupancy import occupancy_table, run_occupancy
    from tools.reproduce.occupancy_methods import METHODS, OccupancyConfig

    config = OccupancyConfig(held_out_run=held_out_run)
    if keep_every_sample:
        config = replace(config, merge_data=0.0, merge_noise=0.0)
    summary = run_occupancy(
        data,
        out,
        logs or tuple(LANDSCAPES),
        methods or METHODS,
        _seeds(seed, repeats),
        config,
        overwrite,
    )
    _report(summary, "Occupancy maps", occupancy_table(summary), out, out, json)


def semantic(
    *,
    data: Path,
    out: Path,
    dataset: str = "semantickitti",
    protocols: tuple[str, ...] = (),
    methods: tuple[str, ...] = (),
    sequences: tuple[str, ...] = (),
    seed: int = 0,
    repeats: int = 1,
    overwrite: bool = False,
    json: JsonFile = None,
) -> None:
    """Semantic maps of labelled scans: ContraMap, a Hilbert map of the same kernels, and k-d trees.

    Example: contramap reproduce semantic --data ../shared/data/semantickitti --protocols points --out sem

    Args:
        data: Folder of the data set: sequences/00/velodyne ... for semantickitti; scenenet/ or aws_worlds/.
        out: Folder for runs and table; a command that was cut off goes on there.
        dataset: semantickitti, scenenet or house.
        protocols: points, blocks, next, last, merged (last scan, from one and all before), labels10 to
            labels40, patches10 to patches40; all when left out.
        methods: contramap, hilbert, nearest, vote, voxel; all when left out.
        sequences: Sequences of semantickitti, such as 00 03; 00 to 09 when left out.
        seed: First seed.
        repeats: Number of seeds.
        overwrite: Compute again what is there already.
        json: Also write the figures to this file.
    """
    from tools.reproduce.semantic.methods import METHODS
    from tools.reproduce.semantic.protocols import PROTOCOLS
    from tools.reproduce.semantic.run import run_semantic, semantic_table

    summary = run_semantic(
        data,
        out,
        dataset,
        protocols or PROTOCOLS,
        methods or METHODS,
        sequences,
        _seeds(seed, repeats),
        overwrite=overwrite,
    )
    _report(summary, "Semantic maps", semantic_table(summary), out, out, json)


def hinges(
    *,
    data: Path,
    out: Path,
    log: str = "intel",
    counts: tuple[int, ...] = (350, 700, 1400, 2800, 5600),
    methods: tuple[str, ...] = (),
    seed: int = 0,
    repeats: int = 3,
    overwrite: bool = False,
    json: JsonFile = None,
) -> None:
    """AUC and time against the number of hinge points, for 0, 1 and 2 hidden layers and the Bayesian map.

    Example: contramap reproduce hinges --data ../shared/data/radish --out hinges_out

    Args:
        data: Folder of CARMEN logs, such as intel-corrected.log.gz.
        out: Folder for runs, table and figure; a command that was cut off goes on there.
        log: The log that is mapped.
        counts: Numbers of hinge points.
        methods: contramap_0, contramap_1, contramap_2, bayesian_hilbert; all when left out.
        seed: First seed.
        repeats: Number of seeds.
        overwrite: Compute again what is there already.
        json: Also write the figures to this file.
    """
    from tools.reproduce.hinges import METHODS, hinges_table, run_hinges

    if not counts or min(counts) < 1:
        raise ConfigError(f"--counts wants numbers of hinge points > 0, got {counts}")
    summary = run_hinges(
        data, out, log, counts, methods or METHODS, _seeds(seed, repeats), overwrite=overwrite
    )
    _report(summary, "Number of hinge points", hinges_table(summary), out, out / "hinges.png", json)


def _seeds(first: int, repeats: int) -> tuple[int, ...]:
    if repeats < 1:
        raise ConfigError(f"--repeats must be at least 1, got {repeats}")
    return tuple(range(first, first + repeats))


def _report(
    summary: dict[str, Any], title: str, table: str, out: Path, figure: Path, json: Path | None
) -> None:
    write_atomically(out / "table.md", with_provenance(title, table))
    print(table)
    print(f"table: {out / 'table.md'}")
    print(f"figures: {figure}")
    write_json(summary, json)
