"""`live` killed at random times: ``python -m benchmarks.live_kills [--count 50] [--memory 50MB]``.

A recording is played on the bus, slowly; `insonify live` hears it, is killed (SIGKILL) at a random
time and started again, so many times, and ended by SIGTERM when all is played.  Once the player is
halted for 15 s, longer than DDS keeps one that is silent, and goes on.  Then every ping that was on
the disk at any kill must be in what `live` leaves, and its map must be that which `map` makes of
the recordings, byte for byte.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from insonify.errors import RecordingError
from insonify.io.recordings import open_bag_at, open_recording
from insonify.io.recordings.recording import RecordingWarning
from insonify.live.keeping import RECORDINGS, kept_bytes

LOOPBACK = (
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo' multicast='false'/>"
    "</Interfaces><AllowMulticast>false</AllowMulticast></General><Discovery>"
    "<ParticipantIndex>auto</ParticipantIndex><Peers><Peer Address='localhost'/></Peers>"
    "</Discovery></Domain></CycloneDDS>"
)
"""The bus: this machine alone."""
SMALL = ["--set", "mapping.voxel_m=0.25"]
_STARTED_S, _HALTED_S = 60.0, 15.0


@dataclass(slots=True)
class Trial:
    """What came of it.

    Attributes:
        kills: How often it was killed.
        received: Pings in what it left.
        flushed: Pings that were on the disk at a kill.
        lost: Of them, those that are not in what it left.
        same: Whether its map is that of its recordings.
        doubled: Pings that are in its recordings twice.
    """

    kills: int = 0
    received: int = 0
    flushed: set[int] = field(default_factory=set)
    lost: int = 0
    same: bool = False
    doubled: int = 0

    @property
    def good(self) -> bool:
        """Whether nothing was lost and the map is the recordings'."""
        return self.same and self.lost == 0 and self.doubled == 0


def start(*words: str, home: Path) -> subprocess.Popen[str]:
    """A command line, in a folder."""
    line = [sys.executable, "-m", "insonify", *words]
    return subprocess.Popen(
        line, cwd=home, text=True, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    )


def stamps(folder: Path) -> list[int]:
    """The stamps of the pings in a folder of recordings, as far as they can be read."""
    found: list[int] = []
    for file in sorted(folder.glob("*.mcap")):
        with suppress(RecordingError, OSError):  # it is gone on with at this moment
            bag = open_bag_at(file)
            if bag is not None:
                found += [message.time_ns for message in bag.read({"/sonar/state"})]
    return found


def on_the_disk(home: Path, target: str) -> set[int]:
    """The stamps of all pings beside a target that is not there yet."""
    return {
        stamp
        for scratch in home.glob(f".{target}-*")
        for stamp in stamps(scratch / "new" / RECORDINGS)
    }


def _bytes(home: Path, target: str) -> int:
    """The most bytes of recordings in a scratch folder."""
    sizes = [0]
    for scratch in home.glob(f".{target}-*"):
        with suppress(OSError):
            sizes.append(kept_bytes(scratch / "new"))
    return max(sizes)


def trial(
    home: Path,
    recording: Path,
    rate: float,
    kills: int,
    rng: np.random.Generator,
    halts: int = 0,
    memory: str | None = None,
) -> Trial:
    """Play a recording, and kill who hears it.

    Args:
        home: A folder for it all.
        recording: What is played.
        rate: How fast.
        kills: How often, while it is played.
        rng: Says when.
        halts: How often the player is halted.
        memory: What the map's blocks may take in memory, the others being on disk.
    """
    told = Trial()
    halted = set(rng.choice(kills, min(halts, kills), replace=False)) if kills else set()
    words = ["live", *SMALL, "--out", "L", *(["--memory", memory] if memory else [])]
    live = start(*words, home=home)
    player = start("play", str(recording), "--rate", str(rate), "--wait", "120", home=home)
    while told.kills < kills and player.poll() is None:
        before = _bytes(home, "L")
        until = time.monotonic() + _STARTED_S  # a kill before it hears anything tells little
        while _bytes(home, "L") <= before and time.monotonic() < until:
            if player.poll() is not None:
                break
            time.sleep(0.2)
        if told.kills in halted:
            player.send_signal(signal.SIGSTOP)
            time.sleep(_HALTED_S)
            player.send_signal(signal.SIGCONT)
        time.sleep(rng.uniform(0.0, 3.0))
        live.kill()
        live.communicate()
        told.kills += 1
        told.flushed |= on_the_disk(home, "L")
        live = start(*words, home=home)
    player.communicate()
    time.sleep(4.0 if live.poll() is None else 0.0)
    live.send_signal(signal.SIGTERM)
    _, words_said = live.communicate(timeout=120)
    assert live.returncode == 0, words_said
    _judge(told, home)
    return told


def _judge(told: Trial, home: Path) -> None:
    """Hold what was left against what was on the disk, and against `map`."""
    left = stamps(home / "L" / RECORDINGS)
    told.received = len(left)
    told.doubled = len(left) - len(set(left))
    told.lost = len(told.flushed - set(left))
    parts = [str(file) for file in sorted((home / "L" / RECORDINGS).glob("*.mcap"))]
    for words in (["map", *parts, *SMALL, "--out", "M"], ["export", "L", "L.npz"]):
        again = start(*words, home=home)
        _, said = again.communicate(timeout=600)
        assert again.returncode == 0, said
    told.same = (home / "L.npz").read_bytes() == (home / "M/map.npz").read_bytes()


def simulated(home: Path, waypoints: int) -> Path:
    """The recording of a scan."""
    fine = ["--set", f"survey.waypoints={waypoints}", "--set", "entropy.max_scans=2"]
    done = start("scan", "tetrapod", *SMALL, *fine, "--out", "S", home=home)
    _, said = done.communicate(timeout=600)
    assert done.returncode == 0, said
    return home / "S" / "recording.mcap"


def main() -> None:
    """Kill it, and say what came of it."""
    parser = argparse.ArgumentParser(description="Kill live at random times.")
    parser.add_argument("--count", type=int, default=50, help="kills")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=8.0, help="of play for each kill")
    parser.add_argument("--memory", help="map on disk, with so much memory for blocks")
    options = parser.parse_args()
    os.environ["CYCLONEDDS_URI"] = LOOPBACK
    os.environ.setdefault("ROS_DOMAIN_ID", "77")
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordingWarning)
        home = Path(folder)
        recording = simulated(home, 200)
        times = [posed.ping.time_s for posed in open_recording(recording)]
        rate = (times[-1] - times[0]) / (options.seconds * options.count)
        rng = np.random.default_rng(options.seed)
        told = trial(home, recording, rate, options.count, rng, halts=1, memory=options.memory)
    print(f"pings played                  {len(times)}")
    print(f"kills                         {told.kills}")
    print(f"pings received                {told.received}")
    print(f"pings on the disk at a kill   {len(told.flushed)}")
    print(f"of them lost                  {told.lost}")
    print(f"pings recorded twice          {told.doubled}")
    print(f"map is that of the recordings {told.same}")
    sys.exit(0 if told.good else 1)


if __name__ == "__main__":
    main()
