"""The project's errors. Each message says what was wrong, where, and how to mend it."""

from __future__ import annotations


class ContraMapError(Exception):
    """Base of every error that bad input can cause; the CLI prints it as one line and exits with 2."""


class ConfigError(ContraMapError):
    """A setting, preset or argument that does not exist or does not fit; the message lists valid ones."""


class DataError(ContraMapError):
    """Arrays or files that are not what was asked for."""


class FrameError(DataError):
    """An RGB-D frame that cannot be mapped: missing file, wrong size, implausible depth, bad intrinsics."""
