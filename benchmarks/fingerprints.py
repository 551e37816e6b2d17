"""Hashes of everything that must not change from one version to the next by accident.

``python -m benchmarks.fingerprints --out before.json`` runs the jobs below through the command line
and notes the SHA-256 of each map, recording, image, table and dataset they leave.  After a change,
``python -m benchmarks.fingerprints --against before.json`` runs them again and prints what differs.
Reports and summaries (``result.json``, ``config.toml``, HTML) are not among them: they may grow.
``--data DIR`` names a folder with worlds and recordings of others; jobs that lack theirs are left
out.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

KEPT = {".npz", ".ply", ".mcap", ".csv", ".png", ".xyz", ".json"}
LEFT_OUT = {"result.json", "decisions.npz", "truth.npz"}
SIMULATIONS = (
    "fls-tank", "fls-grid", "fls-structures", "msis-tank", "msis-turning", "msis-structures",
)  # fmt: skip
WAYPOINTS = "-16 -2 -50 0; -10 -2 -50 0"
EVENLY = [f"{t} {0.05 * t} 0 -5 0 0 0 1" for t in range(3)]


def jobs(data: Path, scratch: Path) -> Iterator[tuple[str, list[str]]]:
    """Names of jobs and their command lines, without ``--out``."""
    yield "scan tetrapod", ["scan", "tetrapod"]
    yield "scan wreck", ["scan", "wreck"]
    yield "scan wreck flown", ["scan", "wreck", "--vehicle", "bluerov2", "--navigation", "dvl"]
    for name in SIMULATIONS:
        yield f"simulate {name}", ["simulate", name, "--truth"]
    physical = ["--model", "physical", "--pose", "-2 0 -2 0 0 0"]
    yield "simulate physical", ["simulate", "tank", "--sonar", "gemini-720i", *physical]
    yield "dataset", ["dataset", "fls-structures", "--count", "6", "--workers", "1"]
    world = data / "worlds" / "sunken_ship_site.world"
    if world.is_file():
        yield "fly", ["fly", str(world), "--waypoints", WAYPOINTS]
    recordings = data / "recordings"
    turtle = recordings / "holoocean_turtle.npz"
    if turtle.is_file():
        threshold = ["--set", "mapping.pixel_threshold=12"]
        yield "map turtle", ["map", str(turtle), "--voxel", "0.02", *threshold]
    for name in ("sample.aris", "oculus_three_pings_8bit.raw"):
        file = recordings / name
        if file.is_file():
            poses = _poses(file, scratch)
            yield f"map {name}", ["map", str(file), "--poses", str(poses), "--voxel", "0.1"]


def _poses(file: Path, scratch: Path) -> Path:
    """Poses over a recording's time, a slow way ahead."""
    told = json.loads(_run(["info", str(file), "--json"]))
    rows = EVENLY[: told["pings"]]
    if told["clock"]:
        start, rest = told["first_s"], (0, 0, 0, 1)
        rows = [f"{start + k!r} {0.05 * k} 0 -5 {' '.join(map(str, rest))}" for k in range(-1, 100)]
    path = scratch / f"{file.name}.tum"
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return path


def _run(words: list[str]) -> str:
    command = [sys.executable, "-m", "insonify", *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(words)}: exit {done.returncode}\n{done.stderr}")
    return done.stdout


def fingerprints(folder: Path) -> dict[str, str]:
    """The hash of each file of a result that counts, by its path."""
    found = {}
    for file in sorted(folder.rglob("*")):
        inside = file.relative_to(folder)
        zarr = any(part.endswith(".zarr") for part in inside.parts)
        kept = (file.suffix in KEPT or zarr) and file.name not in LEFT_OUT
        if file.is_file() and kept:
            found[inside.as_posix()] = hashlib.sha256(file.read_bytes()).hexdigest()
    return found


def main() -> None:
    """Run the jobs; compare, or write what was found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--out", type=Path)
    parser.add_argument("--against", type=Path)
    parser.add_argument("--only", default="", help="jobs whose name has this in it")
    given = parser.parse_args()
    before = json.loads(given.against.read_text(encoding="utf-8")) if given.against else {}
    found: dict[str, dict[str, str]] = {}
    differing = 0
    with tempfile.TemporaryDirectory() as scratch:
        for name, words in jobs(given.data.absolute(), Path(scratch)):
            if given.only not in name:
                continue
            target = Path(scratch) / name.replace(" ", "-")
            _run([*words, "--out", str(target)])
            found[name] = fingerprints(target)
            line = f"{name}: {len(found[name])} files"
            if name in before:
                then, now = before[name], found[name]
                other = sorted(key for key in then | now if then.get(key) != now.get(key))
                differing += len(other)
                line += ", all as before" if not other else f", differing: {', '.join(other[:8])}"
            print(line, flush=True)
    if given.out is not None:
        given.out.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    if differing:
        raise SystemExit(f"{differing} files differ")


if __name__ == "__main__":
    main()
