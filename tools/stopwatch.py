"""Wall-clock and processor time under the names that tables and JSON files have for them."""

from __future__ import annotations

import time


class Stopwatch:
    """Wall-clock and processor time [s] since it was made."""

    def __init__(self) -> None:
        self._wall, self._processor = time.perf_counter(), time.process_time()

    def figures(self, name: str) -> dict[str, float]:
        """{"<name>_s": wall-clock time, "<name>_cpu_s": time of all this process's threads}."""
        return {
            f"{name}_s": time.perf_counter() - self._wall,
            f"{name}_cpu_s": time.process_time() - self._processor,
        }
