"""Which release this is; knows nothing else."""

from __future__ import annotations


def version() -> str:
    """The installed release, such as "0.1.0"; "0+unknown" for a checkout that was never installed."""
    from importlib.metadata import PackageNotFoundError
    from importlib.metadata import version as installed

    try:
        return installed("contramap")
    except PackageNotFoundError:
        return "0+unknown"
