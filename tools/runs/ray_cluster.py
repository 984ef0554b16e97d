"""Ray for the time of a command. Knows how it starts and ends; knows nothing of what runs on it."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from mapping.errors import ConfigError
from tools.runs.signals import handlers_kept


@contextmanager
def ray_cluster(workers: int, address: str | None = None) -> Iterator[Any]:
    """The ray module, on the cluster at `address` or on a local one of `workers` workers, which ends with the
    context; one that was there before stays. Raises ConfigError without ray."""
    try:
        import ray
    except ImportError as error:
        raise ConfigError("--engine ray needs ray: pip install 'contramap[cluster]'") from error
    started = not ray.is_initialized()
    local = {"num_cpus": workers, "include_dashboard": False} if address is None else {"address": address}
    try:
        if started:
            with handlers_kept():
                ray.init(**local, log_to_driver=False, logging_level=logging.ERROR)
        yield ray
    finally:
        if started:  # also when a signal came while it was starting
            ray.shutdown()
