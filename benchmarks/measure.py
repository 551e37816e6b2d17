"""Timing and the rows of the table."""

from __future__ import annotations

import json
import platform
import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import psutil


def machine() -> str:
    """The machine in a line."""
    model = platform.processor() or platform.machine()
    information = Path("/proc/cpuinfo")
    if information.is_file():
        for line in information.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                model = line.split(":", 1)[1].strip()
    cores, memory = psutil.cpu_count(), psutil.virtual_memory().total / 2**30
    return f"{model}, {cores} cores, {memory:.0f} GiB, Python {platform.python_version()}"


@dataclass(frozen=True)
class Row:
    """One figure against its target."""

    name: str
    value: float
    unit: str
    at_least: float | None = None
    at_most: float | None = None

    @property
    def ok(self) -> bool:
        """Whether the target is met."""
        high_enough = self.at_least is None or self.value >= self.at_least
        return high_enough and (self.at_most is None or self.value <= self.at_most)

    def as_json(self, where: str) -> dict[str, object]:
        """The row as it stands in ``build/bench.json``."""
        given = {key: value for key, value in asdict(self).items() if value is not None}
        return given | {"ok": self.ok, "machine": where}


def median_s(function: Callable[[], object], repeats: int) -> float:
    """Median wall time of a call, after one call that is not counted."""
    function()
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds)


def write(rows: list[Row], path: Path) -> None:
    """Write the rows as JSON."""
    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps([row.as_json(machine()) for row in rows], indent=2)
    path.write_text(text + "\n", encoding="utf-8")
