"""Hardware in the loop: ``python -m benchmarks.live_mission [--scans 6] [--voxel 0.1]``.

Two processes on the loopback bus scan the tetrapod.  A simulated robot pings, and flies the paths
that come; `insonify live --plan` maps the pings, and sends each next path, until it says that there
is none worth flying.  First `scan tetrapod --live-bus`, a sonar that is where its path says; then
`fly tetrapod --live`, a BlueROV2 in real time, whose first scan is a pass by the object.

Printed for both: how it ended, the F1 of the map of `live` against the true world, that of the maps
made offline of the same pings (by the robot itself, and by `insonify map` of what was recorded),
whether these are the same bytes, what was lost, and the time from ping to map.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.live_kills import LOOPBACK
from insonify.evaluation import solid_f1
from insonify.io.maps import load_map
from insonify.io.recordings.ros.frame_tree import stamp_ns
from insonify.io.truth import load_truth
from insonify.live.bus import Bus
from insonify.live.publishing import DIAGNOSTICS, PATH

AREA = "-5.05 -4.85 -19.8 5.05 4.85 -16.317"
"""The order's, about the tetrapod."""
PASS = "-9 0 -14 0; 3 0 -14 0"
_SONAR = '[[sonars]]\nname = "sonar"\nrate_hz = 4\nsonar = "park-2025"\n'


def start(*words: str, home: Path) -> subprocess.Popen[str]:
    """A command line."""
    line = [sys.executable, "-m", "insonify", *words]
    return subprocess.Popen(
        line, cwd=home, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )


def done(process: subprocess.Popen[str]) -> str:
    """What it printed; it must end well."""
    out, told = process.communicate(timeout=3600)
    if process.returncode:
        raise SystemExit(f"{process.args!r}: exit {process.returncode}\n{told}")
    return out


def followed(robot: subprocess.Popen[str]) -> tuple[int, str]:
    """How many paths were sent while a robot flies, and what `live` says of its last decision."""
    sent, why = set[int](), ""
    with Bus() as bus:
        while robot.poll() is None:
            for message in bus.poll(lambda topic, kind: topic in (PATH, DIAGNOSTICS), 0.2):
                told = message.decode()
                if message.topic == DIAGNOSTICS:
                    words = str(told.status[0].message)
                    why = words if "next scan" in words else why
                elif told.poses:
                    sent.add(stamp_ns(told.header))
    return len(sent), why


def flown(name: str, robot: list[str], options: argparse.Namespace, home: Path) -> dict[str, Any]:
    """Both ends of a mission; what came of it."""
    mapping = ["--set", f"mapping.voxel_m={options.voxel}"]
    scans = ["--set", f"entropy.max_scans={options.scans}"]
    live, out = f"{name}-live", f"{name}-robot"
    words = ["live", *mapping, *scans, "--plan", "--region", AREA, "--idle", "20"]
    listening = start(*words, "--out", live, "--json", home=home)
    flying = start(*robot, "--out", out, "--json", home=home)
    paths, why = followed(flying)
    result = json.loads(done(flying))
    counts = json.loads(done(listening))["messages"]
    parts = sorted(str(one) for one in (home / live / "recordings").iterdir())
    done(start("map", *parts, *mapping, "--out", f"{name}-map", home=home))
    maps = [home / live / "map.npz", home / f"{name}-map" / "map.npz"]
    own = home / out / "map.npz"
    if own.is_file():
        shutil.copy2(home / out / "truth.npz", home)
    else:  # `fly` makes no map
        done(start("map", f"{out}/sonar.npz", *mapping, "--out", f"{name}-own", home=home))
        own = home / f"{name}-own" / "map.npz"
    truth, _ = load_truth(home / "truth.npz")
    f1 = [solid_f1(load_map(one), truth) for one in (*maps, own)]
    same = len({one.read_bytes() for one in (*maps, own)}) == 1
    latency = counts["latency_ms"]
    print(f"{' '.join(robot[:2])}: {why}", flush=True)
    return {
        "ended": str(result["stop_reason"]),
        "paths sent": str(paths),
        "pings sent, mapped": f"{counts['pings']}, {counts['mapped']}",
        "lost, overwritten, no pose": ", ".join(
            str(counts[name]) for name in ("lost", "overwritten", "unposed")
        ),
        "F1 of live": f"{f1[0]:.6f}",
        "F1 of map, of its recordings": f"{f1[1]:.6f}",
        "F1 of the robot's own pings": f"{f1[2]:.6f}",
        "the three maps": "the same bytes" if same else "DIFFERENT",
        "ping to map, median": f"{latency['median']:.1f} ms",
        "ping to map, 99 %": f"{latency['p99']:.1f} ms",
    }


def main() -> None:
    """Fly both, and print what came of them."""
    parser = argparse.ArgumentParser(description="A mission in two processes, on the bus.")
    parser.add_argument("--scans", type=int, default=6, help="most, after the first")
    parser.add_argument("--voxel", type=float, default=0.1, help="m")
    options = parser.parse_args()
    os.environ["CYCLONEDDS_URI"] = LOOPBACK
    os.environ.setdefault("ROS_DOMAIN_ID", "79")
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        (home / "one.toml").write_text(_SONAR, encoding="utf-8")
        mapping = ["--set", f"mapping.voxel_m={options.voxel}"]
        fly = ["fly", "tetrapod", "--sonars", "one.toml", "--waypoints", PASS, "--live"]
        robots = {
            "scan tetrapod --live-bus": ["scan", "tetrapod", "--live-bus", *mapping],
            "fly tetrapod --live": fly,
        }
        told = {
            name: flown(name.split()[0], words, options, home) for name, words in robots.items()
        }
    first, *others = told.values()
    print(f"{'':30}" + "".join(f"{name:>28}" for name in told))
    for row in first:
        print(f"{row:30}" + "".join(f"{one[row]:>28}" for one in (first, *others)))
    sys.exit(0 if all(one["the three maps"] == "the same bytes" for one in told.values()) else 1)


if __name__ == "__main__":
    main()
