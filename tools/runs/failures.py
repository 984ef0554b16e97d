"""What a command says at its end when some of its runs failed."""

from __future__ import annotations

from mapping.errors import ContraMapError


class RunsFailed(ContraMapError):
    """Some runs failed while others are fine: nothing is wrong with the input, but not all is there."""

    exit_code = 1
