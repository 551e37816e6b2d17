"""Whether `live` keeps up: ``python -m benchmarks.live_rate [--seconds 60] [--rate 20]``.

An Oculus-like head (130 degrees, 512 beams x 1000 bins, 20 m, tilted by 20 degrees) is flown over a
field of objects by `insonify fly`, which takes a while and is kept in ``build/``.  `insonify play`
publishes that at the head's rate from one core, over DDS on the loopback interface, and `insonify
live` maps it on one other core.  Printed every few seconds: pings published, pings mapped, how many
of them lie between, the share of its core that `live` took, the share that others took, and its
memory; then what was lost or late, and the time from a ping's sending to its place in the map.

A yardstick, a loop of plain Python, is timed on `live`'s core before and after, so that a machine
that is slow or taken by others shows as such.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil

from benchmarks.live_kills import LOOPBACK
from benchmarks.measure import machine

KEPT = Path("build") / "live_rate"
SPEED_MPS = 0.46
"""Of the vehicle that `fly` takes by itself."""
_HEAD = """[[sonars]]
name = "sonar"
rate_hz = {rate:g}

[sonars.sonar]
preset = "oculus-m1200d-1200khz"
range_max_m = {range_m:g}
beams = {beams}
bins = {bins}
tilt_deg = 20.0
"""
_ALONE = dict.fromkeys(("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
_LOOP = "sum(number * number for number in range(3_000_000))"
_YARDSTICK = (
    "import time\nfound = []\nfor _ in range(3):\n"
    "    wall, cpu = time.perf_counter(), time.process_time()\n"
    f"    {_LOOP}\n"
    "    found.append((time.process_time() - cpu, time.perf_counter() - wall))\n"
    "print(*min(found))\n"
)


@dataclass(frozen=True, slots=True)
class Moment:
    """What was so at a time.

    Attributes:
        time_s: Since the first ping.
        published: Pings that the player has sent, by their states, which come with them.
        mapped: Of them, those in the map.
        waiting: Those that wait for a pose.
        cpu_s: CPU time of `live` by then.
        busy_s: Time that its core has been busy, with anything.
        resident_mb: Memory of `live`.
    """

    time_s: float
    published: int
    mapped: int
    waiting: int
    cpu_s: float
    busy_s: float
    resident_mb: float

    @property
    def behind(self) -> int:
        """Pings that were sent and are not in the map."""
        return self.published - self.mapped


@dataclass(slots=True)
class Watch:
    """Follows both ends of the bus from outside.

    Attributes:
        live: The process that maps.
        core: Its core.
        moments: What was seen, at each of its reports of health.
    """

    live: psutil.Process
    core: int
    moments: list[Moment] = field(default_factory=list)
    published: int = 0
    _begun_s: float = 0.0

    def hear(self, topic: str, message: Any) -> None:
        """Take a message of the bus."""
        if topic.endswith("/state"):
            self.published += 1
            self._begun_s = self._begun_s or time.monotonic()
            return
        values = {one.key: one.value for one in message.status[0].values}
        used, core = self.live.cpu_times(), psutil.cpu_times(percpu=True)[self.core]
        self.moments.append(
            Moment(
                time.monotonic() - self._begun_s if self._begun_s else 0.0,
                self.published,
                int(values["mapped"]),
                int(values["waiting"]),
                used.user + used.system,
                sum(core) - core.idle - getattr(core, "iowait", 0.0) - getattr(core, "guest", 0.0),
                self.live.memory_info().rss / 1e6,
            )
        )


def start(core: int, *words: str, home: Path, **more: Any) -> subprocess.Popen[str]:
    """A command line that stays on a core."""
    line = [sys.executable, "-c", _PINNED.format(core=core), *words]
    return subprocess.Popen(line, cwd=home, text=True, env=os.environ | _ALONE, **more)


_PINNED = (
    "import os, sys\nos.sched_setaffinity(0, {{{core}}})\n"
    "from insonify.__main__ import main\nmain()\n"
)


def yardstick(core: int) -> tuple[float, float]:
    """CPU and wall seconds of a loop of plain Python on a core, the best of three."""
    code = f"import os\nos.sched_setaffinity(0, {{{core}}})\n{_YARDSTICK}"
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    cpu_s, wall_s = map(float, shown.stdout.split())
    return cpu_s, wall_s


def recorded(options: argparse.Namespace) -> Path:
    """The recording of a flight as long as is asked for, made unless it is kept."""
    name = f"{options.beams}x{options.bins}-{options.range:g}m-{options.rate:g}Hz"
    folder = KEPT / f"{name}-{options.seconds:g}s"
    if not (folder / "pings.mcap").is_file():
        KEPT.mkdir(parents=True, exist_ok=True)
        head = KEPT / f"{name}.toml"
        told = {"rate": options.rate, "range_m": options.range}
        head.write_text(_HEAD.format(beams=options.beams, bins=options.bins, **told))
        half_m = options.seconds * SPEED_MPS / 2
        way = f"{-half_m} -6 -15 0; {half_m} -6 -15 0"
        words = ["fly", "field", "--sonars", str(head), "--waypoints", way, "--mcap"]
        command = [sys.executable, "-m", "insonify", *words, "--force", "--out", str(folder)]
        print(f"flying: {' '.join(command[2:])}", flush=True)
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        (folder / "sonar.npz").unlink(missing_ok=True)  # the same pings again
    return (folder / "pings.mcap").absolute()


def run(
    recording: Path, options: argparse.Namespace, home: Path
) -> tuple[dict[str, Any], list[Moment]]:
    """Play and map; what `live` says at its end, and what was seen meanwhile."""
    from insonify.live.bus import Bus
    from insonify.live.publishing import DIAGNOSTICS

    player_core, live_core = options.cores
    os.sched_setaffinity(0, {player_core})
    words = ["live", "--voxel", str(options.voxel), "--out", "L", "--json"]
    live = start(live_core, *words, home=home, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    watch = Watch(psutil.Process(live.pid), live_core)
    player = start(
        player_core, "play", str(recording), "--wait", "300", home=home,
        stderr=subprocess.PIPE,
    )  # fmt: skip
    ended_s = 0.0
    try:
        with Bus() as bus:
            while not ended_s or time.monotonic() < ended_s + 3.0:
                for message in bus.poll(lambda topic, kind: _wanted(topic, DIAGNOSTICS), 0.2):
                    watch.hear(message.topic, message.decode())
                if not ended_s and player.poll() is not None:
                    ended_s = time.monotonic()
                assert live.poll() is None, live.communicate()[1]
    finally:
        player.terminate()
        live.send_signal(signal.SIGTERM)
    out, words_said = live.communicate(timeout=600)
    _, player_said = player.communicate()
    assert live.returncode == player.returncode == 0, words_said + player_said
    return json.loads(out), watch.moments


def _wanted(topic: str, diagnostics: str) -> bool:
    return topic == diagnostics or topic.endswith("/state")


def show(moments: list[Moment], every_s: float) -> None:
    """What was so at every few seconds."""
    print("   time  published  mapped  behind  waiting   live's CPU  others there   memory")
    last = moments[0]
    for one in moments:
        if one.time_s - last.time_s < every_s and one is not moments[-1]:
            continue
        passed_s = max(one.time_s - last.time_s, 1e-9)
        share = (one.cpu_s - last.cpu_s) / passed_s
        others = max(0.0, (one.busy_s - last.busy_s) / passed_s - share)
        print(
            f"{one.time_s:5.0f} s {one.published:10} {one.mapped:7} {one.behind:7} "
            f"{one.waiting:8} {share:11.0%} {others:13.0%} {one.resident_mb:5.0f} MB"
        )
        last = one


def main() -> None:
    """Say whether it keeps up."""
    parser = argparse.ArgumentParser(description="Whether live keeps up on one core.")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--rate", type=float, default=20.0, help="pings a second")
    parser.add_argument("--beams", type=int, default=512)
    parser.add_argument("--bins", type=int, default=1000)
    parser.add_argument("--range", type=float, default=20.0, help="m")
    parser.add_argument("--voxel", type=float, default=0.1, help="m")
    parser.add_argument("--every", type=float, default=5.0, help="seconds between two rows")
    parser.add_argument(
        "--cores", type=int, nargs=2, default=sorted(os.sched_getaffinity(0))[:2],
        metavar=("PLAY", "LIVE"),
    )  # fmt: skip
    options = parser.parse_args()
    if len(options.cores) != 2:
        parser.error("it takes two cores")
    os.environ["CYCLONEDDS_URI"] = LOOPBACK
    os.environ.setdefault("ROS_DOMAIN_ID", "78")
    print(f"machine            {machine()}")
    recording = recorded(options)
    before = yardstick(options.cores[1])
    with tempfile.TemporaryDirectory() as folder:
        told, moments = run(recording, options, Path(folder))
    after = yardstick(options.cores[1])
    playing = [one for one in moments if one.published]
    show(playing, options.every)
    counts, last = told["messages"], playing[-1]
    busy = [one for one in playing if one.published < last.published]
    wall_s = busy[-1].time_s - busy[0].time_s
    print(f"published          {last.published} pings of {options.bins} x {options.beams}")
    rate = (busy[-1].mapped - busy[0].mapped) / wall_s
    print(f"mapped             {counts['mapped']}, {rate:.2f} a second")
    late = (
        "unposed", "duplicates", "out_of_order", "damaged", "refused", "late_poses", "lost",
        "overwritten",
    )  # fmt: skip
    print(f"not mapped         {last.published - counts['mapped']}")
    print(f"                   {', '.join(f'{name} {counts[name]}' for name in late)}")
    print(f"behind             at most {max(one.behind for one in playing)} pings")
    latency = counts["latency_ms"]
    print(f"ping to map        median {latency['median']:.0f} ms, 99 % {latency['p99']:.0f} ms")
    cpu_s = busy[-1].cpu_s - busy[0].cpu_s
    per_ping = cpu_s / (busy[-1].mapped - busy[0].mapped)
    print(f"CPU of live        {cpu_s / wall_s:.0%} of its core, {1e3 * per_ping:.1f} ms a ping")
    for name, (cpu, wall) in {"before": before, "after": after}.items():
        print(f"yardstick {name:8} {1e3 * cpu:.0f} ms of CPU, {1e3 * wall:.0f} ms by the clock")
    good = counts["mapped"] == last.published and busy[-1].behind <= 2 * options.rate
    print(f"keeps up           {'yes' if good else 'no'}")
    sys.exit(0 if good else 1)


if __name__ == "__main__":
    main()
