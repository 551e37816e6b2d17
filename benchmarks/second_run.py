"""Where the seconds of ``insonify scan tetrapod`` go: ``python -m benchmarks.second_run``.

Each run is a process of its own, as a user's; the first compiles kernels and is not counted.
"""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import tempfile

from rich.console import Console
from rich.table import Table

from benchmarks.measure import machine

RUNS = 5

_SCAN = """
import json, sys, time
from pathlib import Path
import psutil
begun = psutil.Process().create_time()
laps = {}
def lap(name):
    global begun
    laps[name] = laps.get(name, 0.0) + time.time() - begun
    begun = time.time()
import insonify.cli
from insonify.mission.setup import scenario_config
from insonify.results.scan import run_scan
lap("start and imports")
config = scenario_config("tetrapod")
names = ["scanning, with recording and scores"]
def phase(name):
    lap(names[-1])
    names.append(name)
result, _ = run_scan(config, Path(sys.argv[1]), phase=phase)
lap(names[-1])
within = {f"  of it {name}": seconds for name, seconds in result.seconds.items()}
print(json.dumps(laps | within))
"""


def main() -> None:
    """Print the table."""
    rows: list[dict[str, float]] = []
    for _ in range(RUNS + 1):
        with tempfile.TemporaryDirectory() as folder:
            done = subprocess.run(
                [sys.executable, "-c", _SCAN, f"{folder}/run"],
                capture_output=True, text=True, check=True,
            )  # fmt: skip
            rows.append(json.loads(done.stdout))
    table = Table("what", "seconds", "share", title=machine())
    middle = {name: statistics.median(row[name] for row in rows[1:]) for name in rows[0]}
    total = sum(seconds for name, seconds in middle.items() if not name.startswith(" "))
    for name, seconds in [*middle.items(), ("all", total)]:
        table.add_row(name, f"{seconds:.2f}", f"{seconds / total:.0%}")
    Console(width=80).print(table)


if __name__ == "__main__":
    main()
