"""One scene with one seed: every method on the same observation, each result kept in a file of its own."""

from __future__ import annotations

import json
import math
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any
from zlib import crc32

import numpy as np

from mapping.errors import ContraMapError
from reconstruction.atomic import temporary_beside, write_atomically
from reconstruction.meshing import MeshConfig
from sim_scenes.truth import TRUTH_FILE
from tools.evaluation.case import Case, load_case
from tools.evaluation.methods import FittedMap, method
from tools.evaluation.protocol import coarse_protocol, delivered_meshes, fine_protocol
from tools.evaluation.uncertainty_card import distance_to_samples, ranking_scores, uncertainty_card

NULL_METHOD = "vprism"
"""The method whose entropy is a null for every other method's uncertainty."""


@dataclass(frozen=True)
class Job:
    """What one worker does in one go: `methods` on one scene with one seed, results below `out`."""

    scene: Path
    seed: int
    methods: tuple[str, ...]
    out: Path
    ycb_dir: Path | None = None
    threads: int = 1

    @property
    def name(self) -> str:
        """For messages."""
        return f"{self.scene.name} seed {self.seed}"

    def result_file(self, name: str) -> Path:
        """Where a method's result of this job is kept."""
        return self.out / "runs" / self.scene.name / f"{name}_seed{self.seed}.json"

    @property
    def null_file(self) -> Path:
        """V-PRISM's entropy on the card's voxels."""
        return self.out / "runs" / self.scene.name / f"{NULL_METHOD}_entropy_seed{self.seed}.npy"

    @property
    def fingerprint(self) -> int:
        """Tells scenes of one name apart."""
        return crc32((self.scene / TRUTH_FILE).read_bytes())

    def missing(self) -> tuple[str, ...]:
        """Methods without a result yet, V-PRISM first: the others are compared with its entropy."""
        open_ones = [name for name in self.methods if not self.result_file(name).is_file()]
        return tuple(sorted(open_ones, key=lambda name: name != NULL_METHOD))


def run_job(job: Job, done: Callable[[str], None] = lambda name: None) -> list[dict[str, str]]:
    """Do what is missing of a job; returns what failed as {scene, seed, method, error}.

    A method that fails leaves no file, so it is tried again when the evaluation is run again.
    """
    import torch

    torch.set_num_threads(job.threads)
    failures: list[dict[str, str]] = []
    todo = job.missing()
    if not todo:
        return failures
    job.result_file(todo[0]).parent.mkdir(parents=True, exist_ok=True)
    try:
        case = load_case(job.scene, job.ycb_dir)
    except ContraMapError as error:
        return [_failure(job, name, str(error)) for name in todo]
    for name in todo:
        try:
            content = evaluate_method(case, name, job)
            write_atomically(job.result_file(name), (json.dumps(content) + "\n").encode())
        except MemoryError:
            failures.append(_failure(job, name, "out of memory"))
        except Exception as error:  # whatever a method does, the other methods and scenes go on
            where = traceback.extract_tb(error.__traceback__)[-1]
            place = f"{Path(where.filename).name}:{where.lineno}"
            failures.append(_failure(job, name, f"{type(error).__name__} in {place}: {error}"))
        done(name)
    return failures


def evaluate_method(case: Case, name: str, job: Job) -> dict[str, Any]:
    """Fit one method on a case and measure everything; see the keys."""
    start = perf_counter()
    fitted = method(name)(case.observation, case.space, case.rng(job.seed, "fit"))
    fit_s = perf_counter() - start
    objects, mesh_s = coarse_protocol(fitted, case, case.rng(job.seed, "coarse"))
    meshes, mesh_5mm_s = delivered_meshes(fitted, case, MeshConfig())
    fine = fine_protocol(meshes, case, case.rng(job.seed, "fine"))
    card, curves, nulls = _card(fitted, case, name, job)
    pixels = np.bincount(case.frame.labels.ravel(), minlength=max(case.judged) + 1)  # type: ignore[union-attr]
    return _plain(
        {
            "scene": case.name,
            "method": name,
            "seed": job.seed,
            "fingerprint": job.fingerprint,
            "threads": job.threads,
            "object_count": len(case.observation.objects),
            "objects": [
                {
                    "label": label,
                    "name": case.frame.name_of(label),
                    "pixels": int(pixels[label]),
                    **objects[label],
                    **fine[label],
                }
                for label in case.judged
            ],
            "card": card,
            "nulls": nulls,
            "curves": curves,
            "fit_s": fit_s,
            "mesh_s": mesh_s,
            "mesh_5mm_s": mesh_5mm_s,
        }
    )


def _card(
    fitted: FittedMap, case: Case, name: str, job: Job
) -> tuple[dict[str, float], dict[str, Any], dict[str, dict[str, float]]]:
    """The method's card, its curves, and the cards of the nulls for the same answers."""
    voxels = case.card_voxels
    probability, uncertainty = fitted.predict(voxels.points)
    scores, curves = uncertainty_card(probability, uncertainty, voxels)
    wrong = probability.argmax(1) != voxels.truth
    distance = distance_to_samples(voxels.points, fitted.samples)
    nulls = {"distance": ranking_scores(distance, wrong, voxels)}
    if name == NULL_METHOD:
        with temporary_beside(job.null_file) as partial, open(partial, "wb") as file:
            np.save(file, uncertainty.astype(np.float32))
    elif job.null_file.is_file():
        nulls[NULL_METHOD] = ranking_scores(np.load(job.null_file), wrong, voxels)
    return scores, curves, nulls


def _failure(job: Job, name: str, error: str) -> dict[str, str]:
    return {"scene": job.scene.name, "seed": str(job.seed), "method": name, "error": error}


def _plain(value: Any) -> Any:
    """The same with NumPy numbers as Python's and NaN as None, as JSON wants it."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
