"""`live --from` against `map`: ``python -m benchmarks.live_equals_map [FILE|FOLDER...]``.

Each recording (by default all of ``../shared/data/recordings``) goes through `insonify map` and
through `insonify live --from`, as a person types them; then `map` makes a map of what `live`
recorded itself.  The three ``map.npz`` must be the same bytes.  A recording without poses gets a
straight way to go with both (``--poses``).  Files that hold no pings are named, and count for
nothing.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.samples import tum_rows
from insonify.errors import InsonifyError
from insonify.io.recordings import open_recording
from insonify.io.recordings.recording import Reading, RecordingWarning

DATA = Path("../shared/data/recordings")
_ROW = "{:34} {:>6} {:>6} {:>12}  {}"


def files(given: list[Path]) -> Iterator[Path]:
    """Files themselves, and all that lie in folders; a folder that is a recording is one."""
    for path in given:
        if path.is_dir() and not (path / "metadata.yaml").is_file():
            yield from sorted(one for one in path.iterdir() if not one.name.startswith("."))
        else:
            yield path


def way(path: Path, home: Path) -> Path | None:
    """Poses for a recording that has none; None if it has.

    Raises:
        InsonifyError: It holds no pings.
    """
    pings = list(open_recording(path, Reading()))
    if any(posed.pose is not None for posed in pings):
        return None
    times = [posed.ping.time_s for posed in pings]
    rows = tum_rows(len(pings))  # one each, where there is no clock
    if times[-1] > times[0]:
        rows = tum_rows(9)
        rows[:, 0] = np.linspace(times[0] - 0.1, times[-1] + 0.1, len(rows))
    np.savetxt(home / "way.tum", rows, fmt="%.9f")
    return home / "way.tum"


def insonify(*words: str, home: Path) -> None:
    """The command line, which must end well."""
    command = [sys.executable, "-m", "insonify", *words]
    done = subprocess.run(command, cwd=home, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"insonify {' '.join(words)}: exit {done.returncode}\n{done.stderr}")


def compared(path: Path, voxel_m: float, home: Path) -> tuple[int, bool]:
    """Bytes of the map of a recording, and whether the three ways to it agree.

    Raises:
        InsonifyError: It holds no pings.
    """
    told = way(path, home)
    words = ["--voxel", str(voxel_m)]
    poses = [] if told is None else ["--poses", str(told)]
    insonify("map", str(path), *poses, *words, "--out", "M", home=home)
    insonify("live", "--from", str(path), *poses, *words, "--out", "L", home=home)
    parts = sorted(str(one) for one in (home / "L/recordings").iterdir())
    insonify("map", *parts, *words, "--out", "N", home=home)
    maps = [(home / name / "map.npz").read_bytes() for name in ("M", "L", "N")]
    return len(maps[0]), maps[0] == maps[1] == maps[2]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Whether live --from makes the map of map.")
    parser.add_argument("recordings", nargs="*", type=Path, default=[DATA])
    parser.add_argument("--voxel", type=float, default=0.1, help="m")
    options = parser.parse_args()
    print(_ROW.format("recording", "pings", "poses", "bytes of map", "live --from, and map again"))
    same: list[bool] = []
    left_out = 0
    for path in files([one.absolute() for one in options.recordings]):
        with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
            warnings.simplefilter("ignore", RecordingWarning)
            home = Path(folder)
            try:
                count = open_recording(path, Reading()).count
                size, equal = compared(path, options.voxel, home)
            except InsonifyError as err:
                print(_ROW.format(path.name, "-", "-", "-", f"left out: {err}"))
                left_out += 1
                continue
            poses = "made" if (home / "way.tum").is_file() else "own"
        same.append(equal)
        word = "the same bytes" if equal else "DIFFERENT"
        print(_ROW.format(path.name, count, poses, size, word), flush=True)
    print(f"{sum(same)} of {len(same)} the same, {left_out} left out")
    sys.exit(0 if same and all(same) else 1)


if __name__ == "__main__":
    main()
