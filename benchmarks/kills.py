"""Commands killed at random times: ``python -m benchmarks.kills [--count N] [--seed S]``.

Every command that writes is started and killed (SIGKILL, with all its processes) at a random time,
up to three times in a row, with and without ``--force`` over an earlier result.  After each kill
what lies at the target must be the earlier result or the new one, whole, and never some of both.
Then the same command runs to its end: it must leave the same bytes as one that was never killed,
what else lay in the folder, and no scratch.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

TIMED = {"result.json", "report.html", "rows.csv", "decision.json"}
"""Files that tell how long something took."""
SMALL = ["--set", "mapping.voxel_m=0.25", "--set", "survey.waypoints=6"]
FLOWN = ["--vehicle", "bluerov2", "--navigation", "dvl", "--planner", "uniform"]
ONE_SCAN = ["--set", "survey.baseline_scans=1", "--set", "survey.approach_m=2.0"]
VIEW = ["--set", "sonar.beams=24", "--set", "sonar.bins=60"]


@dataclass(slots=True)
class Job:
    """A command, and what it leaves when nothing kills it.

    Attributes:
        words: The command line without its target.
        earlier: What is changed for the earlier result that ``--force`` replaces.
        name: Of the target.
        seconds: How long it takes.
        whole: Digests of its files, by name; nothing for those that are timed.
    """

    words: list[str]
    earlier: list[str]
    name: str = "out"
    seconds: float = 0.0
    whole: dict[str, str] = field(default_factory=dict)

    def line(self, place: Path, more: list[str]) -> list[str]:
        """The whole command line; ``export`` takes its target without an option."""
        target = str(place / self.name)
        words = [word.replace("PLACE", str(place.parent)) for word in self.words]
        out = [target] if self.words[0] == "export" else ["--out", target]
        return [sys.executable, "-m", "insonify", words[0], *words[1:], *out, *more]


def jobs() -> dict[str, Job]:
    """The commands, by what they are called; maps are those of the first scan."""
    uniform = ["--planner", "uniform", *ONE_SCAN]
    seed = ["--set", "seed=5"]
    voxel = ["--voxel", "0.4"]
    waypoints = ["--waypoints", "0 0 -1 0; 1 0 -1 0"]
    orbit = ["--orbit", "0 0 -1 2 4 20"]
    views = ["--count", "4", "--workers", "2"]
    return {
        "scan": Job(["scan", "tetrapod", *SMALL, *uniform], seed),
        "scan --vehicle": Job(["scan", "tetrapod", *SMALL, *FLOWN, *ONE_SCAN], seed),
        "map": Job(["map", "PLACE/scan/recording.mcap", "--voxel", "0.25"], voxel),
        "simulate": Job(["simulate", "tank", *VIEW, *orbit, "--truth"], seed),
        "fly": Job(["fly", "tank", *waypoints], seed),
        "dataset": Job(["dataset", "structures", *VIEW, *views], seed),
        "compare": Job(["compare", "tetrapod", "--seeds", "1", "--planner", "uniform", *SMALL,
                        *ONE_SCAN], ["--set", "mapping.voxel_m=0.5"]),
        "export .bt": Job(["export", "PLACE/scan"], [], "m.bt"),
        "export .zarr": Job(["export", "PLACE/scan"], [], "m.zarr"),
    }  # fmt: skip


def digests(target: Path) -> dict[str, str]:
    """SHA-256 of every file of a result; the target itself is ``.``."""
    files = [path for path in (target, *sorted(target.rglob("*"))) if path.is_file()]
    return {
        str(file.relative_to(target)): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in files
    }


def untimed(found: dict[str, str]) -> dict[str, str]:
    """Digests without those that differ from run to run."""
    return {name: "" if Path(name).name in TIMED else digest for name, digest in found.items()}


def run(line: list[str], kill_after_s: float | None = None) -> int:
    """Run a command, or kill it and all that it started; its exit code."""
    with subprocess.Popen(
        line, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    ) as process:
        try:
            return process.wait(kill_after_s)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            return process.wait()


def prepare(job: Job, place: Path) -> None:
    """Find out what a command leaves, and how long it takes."""
    place.mkdir()
    started = time.monotonic()
    if run(job.line(place, [])) != 0:
        sys.exit(f"fails without a kill: {' '.join(job.line(place, []))}")
    job.seconds, job.whole = time.monotonic() - started, untimed(digests(place / job.name))
    earlier = place.with_name(f"{place.name} before")
    earlier.mkdir()
    run(job.line(earlier, job.earlier))
    if (earlier / job.name).is_dir() and job.words[0] != "export":
        (earlier / job.name / "mine").write_text("precious")


def trial(job: Job, home: Path, rng: np.random.Generator, most_kills: int) -> tuple[int, list[str]]:
    """Kill a command some times, then let it end: kills, and what was wrong."""
    place, force = home / "trial", bool(rng.integers(2))
    shutil.rmtree(place, ignore_errors=True)
    if force:
        shutil.copytree(next(home.glob("* before")), place)
    else:
        place.mkdir()
    target, faults, kills = place / job.name, [], 0
    before, line = digests(target), job.line(place, ["--force"] if force else [])
    for _ in range(int(rng.integers(1, most_kills + 1))):
        # half of the kills fall into the last part, where results are published
        least = 0.8 if rng.random() < 0.5 else 0.05
        run(line, job.seconds * float(rng.uniform(least, 1.1)))
        kills += 1
        found = digests(target)
        new = {name: digest for name, digest in found.items() if name != "mine"}
        if found != before and untimed(new) != job.whole:
            faults.append(f"a mixture: {sorted(set(found) ^ set(before))[:5]}")
        if target.exists() and not force:
            break  # it came through before it was killed
    again = line if force or not target.exists() else job.line(place, ["--force"])
    if run(again) != 0:
        faults.append("the same command fails after a kill")
    found = digests(target)
    if found.pop("mine", "") != before.get("mine", ""):
        faults.append("a file that is no result was lost")
    if untimed(found) != job.whole:
        faults.append(f"other bytes: {sorted(untimed(found).items() ^ job.whole.items())[:3]}")
    left = sorted(path.name for path in place.iterdir() if path.name != job.name)
    if left:
        faults.append(f"left: {left}")
    return kills, faults


def kill_all(count: int, seed: int, names: list[str], most_kills: int = 3) -> Counter[str]:
    """Kill the named commands until ``count`` kills are reached; faults by what they are."""
    rng, faults = np.random.default_rng(seed), Counter[str]()
    with tempfile.TemporaryDirectory() as folder:
        home, known = Path(folder), jobs()
        places: dict[str, Path] = {}
        for name in dict.fromkeys(["scan", *names]):
            places[name] = home / name.replace(" ", "-").replace(".", "")
            places[name].mkdir()
            (places[name] / "scan").symlink_to(places["scan"] / "whole" / "out")
            prepare(known[name], places[name] / "whole")
            print(f"{name}: {known[name].seconds:.1f} s without a kill", flush=True)
        done, turn = 0, 0
        while done < count:
            name = names[turn % len(names)]
            kills, found = trial(known[name], places[name], rng, most_kills)
            done, turn = done + kills, turn + 1
            faults.update(f"{name}: {fault}" for fault in found)
            if turn % len(names) == 0:
                print(f"{done} kills, {sum(faults.values())} faults", flush=True)
            for fault in found:
                print(f"    {name}: {fault}", flush=True)
    print(f"{done} kills in {turn} trials, {sum(faults.values())} faults", flush=True)
    return faults


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", action="append", choices=list(jobs()))
    given = parser.parse_args()
    sys.exit(1 if kill_all(given.count, given.seed, given.only or list(jobs())) else 0)


if __name__ == "__main__":
    main()
