"""A job that dies as if the system had killed it, for the tests of the evaluation's engine."""

from __future__ import annotations

import os

from tools.evaluation.job import Job, run_job


def run(job: Job) -> list[dict[str, str]]:
    """Die on scene_0000, work on all others."""
    if job.scene.name == "scene_0000":
        os._exit(9)
    return run_job(job)
