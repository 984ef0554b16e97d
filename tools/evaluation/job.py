"""One scene: every method with every seed on the same observation, each result kept in a file of its own."""

from __future__ import annotations

import json
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np

from mapping.errors import ContraMapError, DataError
from mapping.files import temporary_beside, write_atomically
from mapping.guarded_files import read_npy
from mapping.plain_json import plain
from sim_scenes.truth import TRUTH_FILE
from tools.evaluation.answers import Answers, ask
from tools.evaluation.case import Case, load_case
from tools.evaluation.methods import method
from tools.evaluation.protocol import coarse_protocol, fine_protocol
from tools.evaluation.uncertainty_card import ranking_scores, uncertainty_card
from tools.runs.kept import read_kept

RESULT_FORMAT = 2
"""Raised when results hold something else than before: older ones are measured again."""
RESULT_KEYS = ("scene", "method", "seed", "fingerprint", "object_count", "objects", "card", "nulls", "curves")
NULL_METHOD = "vprism"
"""The method whose entropy is a null for every other method's uncertainty."""


@dataclass(frozen=True)
class Run:
    """One method with one seed."""

    seed: int
    method: str


@dataclass(frozen=True)
class Job:
    """What one worker does in one go: every run of `methods` x `seeds` on one scene, results below `out`.

    Seeds share the scene: it is read, observed and prepared once. given_up: runs not to be tried again.
    """

    scene: Path
    seeds: tuple[int, ...]
    methods: tuple[str, ...]
    out: Path
    ycb_dir: Path | None = None
    threads: int = 1
    given_up: frozenset[Run] = frozenset()

    @property
    def runs(self) -> list[Run]:
        """All runs, V-PRISM first: the others are compared with its entropy."""
        names = sorted(self.methods, key=lambda name: name != NULL_METHOD)
        return [Run(seed, name) for seed in self.seeds for name in names]

    def result_file(self, run: Run) -> Path:
        """Where a run's result is kept."""
        return self.out / "runs" / self.scene.name / f"{run.method}_seed{run.seed}.json"

    def null_file(self, seed: int) -> Path:
        """V-PRISM's entropy on the card's voxels."""
        return self.out / "runs" / self.scene.name / f"{NULL_METHOD}_entropy_seed{seed}.npy"

    @property
    def fingerprint(self) -> int:
        """Tells scenes of one name apart."""
        return crc32((self.scene / TRUTH_FILE).read_bytes())

    def missing(self) -> list[Run]:
        """Runs without a result yet."""
        return [run for run in self.runs if run not in self.given_up and self.kept(run) is None]

    def kept(self, run: Run) -> dict[str, Any] | None:
        """The result of a run; None when there is none, or it is broken, of another version, or lacks what
        other runs need of it."""
        if run.method == NULL_METHOD and not _is_array(self.null_file(run.seed)):
            return None
        return read_kept(self.result_file(run), RESULT_KEYS, format=RESULT_FORMAT)

    def failure(self, run: Run, error: str) -> dict[str, str]:
        """What went wrong with a run, for the report."""
        return {"scene": self.scene.name, "seed": str(run.seed), "method": run.method, "error": error}


def run_job(job: Job, done: Callable[[Run], None] = lambda run: None) -> list[dict[str, str]]:
    """Do what is missing of a job; returns what failed as {scene, seed, method, error}.

    A run that fails leaves no file, so it is tried again when the evaluation is run again.
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
        return [job.failure(run, str(error)) for run in todo]
    seedless: dict[str, Answers] = {}
    for run in todo:
        try:
            answers = seedless.get(run.method) or ask(case, run.method, run.seed)
            if not method(run.method).seeded:
                seedless[run.method] = answers
            content = judge(answers, case, run, job)
            write_atomically(job.result_file(run), (json.dumps(content) + "\n").encode())
        except MemoryError:
            failures.append(job.failure(run, "out of memory"))
        except Exception as error:  # whatever a method does, the other methods and scenes go on
            where = traceback.extract_tb(error.__traceback__)[-1]
            place = f"{Path(where.filename).name}:{where.lineno}"
            failures.append(job.failure(run, f"{type(error).__name__} in {place}: {error}"))
        done(run)
    return failures


def judge(answers: Answers, case: Case, run: Run, job: Job) -> dict[str, Any]:
    """Everything that is measured of one run's answers; see the keys."""
    objects = coarse_protocol(answers.coarse, case, case.rng(run.seed, "coarse"))
    fine = fine_protocol(answers.meshes, case, case.rng(run.seed, "fine"))
    scores, curves = uncertainty_card(answers.probability, answers.uncertainty, case.card_voxels)
    pixels = np.bincount(case.frame.labels.ravel(), minlength=max(case.judged) + 1)  # type: ignore[union-attr]
    return plain(
        {
            "format": RESULT_FORMAT,
            "scene": case.name,
            "method": run.method,
            "seed": run.seed,
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
            "card": scores,
            "nulls": _nulls(answers, case, run, job),
            "curves": curves,
            **answers.seconds,
        }
    )


def _nulls(answers: Answers, case: Case, run: Run, job: Job) -> dict[str, dict[str, float]]:
    """How the null uncertainties rank the same answers."""
    voxels = case.card_voxels
    wrong = answers.probability.argmax(1) != voxels.truth
    nulls = {"distance": ranking_scores(answers.distance, wrong, voxels)}
    null_file = job.null_file(run.seed)
    if run.method == NULL_METHOD:
        with temporary_beside(null_file) as partial, open(partial, "wb") as file:
            np.save(file, answers.uncertainty.astype(np.float32))
    elif _is_array(null_file):
        nulls[NULL_METHOD] = ranking_scores(read_npy(null_file), wrong, voxels)
    return nulls


def _is_array(path: Path) -> bool:
    """Whether a file holds a whole array: one that was cut is made again."""
    try:
        return path.is_file() and read_npy(path).ndim == 1
    except DataError:
        return False
