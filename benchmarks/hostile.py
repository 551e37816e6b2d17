"""Crafted files through the real command: ``python -m benchmarks.hostile [--count N] [--seed S]``.

Each input of `benchmarks.crafted` is read by its command in a child process that has 30 s and 1 GiB
beyond the interpreter.  It may succeed, or refuse in one sentence with exit code 2 and leave
nothing; a trace, a crash, more time or memory, and a folder that is left are failures.  Prints as
it goes, takes ``--seconds`` and ``--reader NAME``, and keeps what failed in ``--keep``.

The libraries are imported once, and each child is forked from there, so that a thousand inputs take
minutes; inputs are known by reader, seed and number alone.
"""

from __future__ import annotations

import argparse
import gc
import importlib
import os
import pkgutil
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from itertools import count
from pathlib import Path

os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import insonify
from benchmarks.crafted import MAKERS
from insonify.cli import main as command
from insonify.jit import cache_folder

MOST_BYTES, MOST_SECONDS = 1 << 30, 30
PATIENCE = 10
"""Seconds are those of its processor; so many times as long by the clock, if others use it too."""
LIBRARIES = ("trimesh", "zarr", "collada", "lz4.frame", "matplotlib.backends.backend_agg")

_ALL = (insonify.__path__, "insonify.")


def attempt(reader: str, seed: int, number: int, folder: Path) -> tuple[str, str]:
    """One input: what came of it, and what was wrong."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    started, child = time.monotonic(), os.fork()
    if child == 0:
        _read(reader, seed, number, folder)
    while (ended := os.waitpid(child, os.WNOHANG))[0] == 0:
        if time.monotonic() - started > PATIENCE * MOST_SECONDS:
            os.kill(child, signal.SIGKILL)
        time.sleep(0.002)
    if os.waitstatus_to_exitcode(ended[1]) in (-signal.SIGXCPU, -signal.SIGKILL):
        return "too long", f"{MOST_SECONDS} s were not enough"
    try:
        code = int((folder / "code").read_text())
    except (OSError, ValueError):
        return "crashed", "it died without a word"
    return _judged(folder, code)


def _read(reader: str, seed: int, number: int, folder: Path) -> None:
    """In the child: make the input, and let the command read it; does not return."""
    code = 99
    try:
        os.chdir(folder)
        words = MAKERS[reader](random.Random(f"{reader} {seed} {number}"))
        (folder / "words").write_text(" ".join(words))
        for stream, name in ((1, "stdout"), (2, "stderr")):
            os.dup2(os.open(name, os.O_CREAT | os.O_WRONLY, 0o600), stream)
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        _, hard = resource.getrlimit(resource.RLIMIT_AS)
        resource.setrlimit(resource.RLIMIT_AS, (used + MOST_BYTES, hard))
        resource.setrlimit(resource.RLIMIT_CPU, (MOST_SECONDS, MOST_SECONDS + 1))
        sys.argv = ["insonify", *words]
        command()
    except SystemExit as err:
        code = err.code if isinstance(err.code, int) else 0
    finally:
        if sys.exc_info()[0] not in (None, SystemExit):
            sys.excepthook(*sys.exc_info())
        sys.stdout.flush()
        sys.stderr.flush()
        (folder / "code").write_text(str(code))
        os._exit(0)


def _judged(folder: Path, code: int) -> tuple[str, str]:
    """What came of an input, and what was wrong, told from what its command left."""
    shown = (folder / "stderr").read_text(errors="replace")
    lines = [line for line in shown.splitlines() if "insonify: warning: " not in line]
    if "Traceback" in shown or code not in (0, 2):
        return "failed", shown.strip().splitlines()[-1][:300] if shown.strip() else f"code {code}"
    if not all(char.isprintable() or char == "\n" for char in shown):
        return "failed", "control characters reach the terminal"
    if code == 0:
        return "read", ""
    lines = [line for line in lines if "compil" not in line]
    if len(lines) != 1 or not lines[0].startswith("insonify: ") or len(lines[0]) > 1100:
        return "failed", f"not one sentence: {' / '.join(lines)[:300]}"
    if any(path.name.startswith((".out", "out")) for path in folder.iterdir()):
        return "failed", "something half-written is left"
    return "refused", ""


def fuzz(
    readers: list[str], seed: int, most: int, seconds: float, keep: Path | None
) -> tuple[int, Counter[str]]:
    """Try inputs of all readers in turn; how many, and the failures by what they are."""
    for module in (*LIBRARIES, *(one.name for one in pkgutil.walk_packages(*_ALL))):
        if "__main__" not in module:
            importlib.import_module(module)
    cache_folder()
    gc.freeze()
    began = told = time.monotonic()
    tally, failures, done = Counter[tuple[str, str]](), Counter[str](), 0
    with tempfile.TemporaryDirectory() as scratch:
        for number in count():
            for reader in readers:
                if done >= most or time.monotonic() - began > seconds:
                    return done, failures
                folder = Path(scratch) / "input"
                outcome, fault = attempt(reader, seed, number, folder)
                done, tally[reader, outcome] = done + 1, tally[reader, outcome] + 1
                if fault:
                    failures[f"{reader}: {fault}"] += 1
                    print(f"FAILED {reader} {number}: {fault}", flush=True)
                    if keep is not None:
                        shutil.copytree(folder, keep / f"{reader}-{seed}-{number}")
                if time.monotonic() - told > 20.0:
                    told = time.monotonic()
                    parts = ", ".join(f"{r} {o} {n}" for (r, o), n in sorted(tally.items()))
                    print(f"{done} inputs, {sum(failures.values())} failures: {parts}", flush=True)
    raise AssertionError("count ends")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=20_000)
    parser.add_argument("--seconds", type=float, default=1e9, help="stop after so long")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--reader", action="append", choices=list(MAKERS))
    parser.add_argument("--keep", type=Path, help="folder for the inputs that fail")
    given = parser.parse_args()
    readers = given.reader or list(MAKERS)
    done, failures = fuzz(readers, given.seed, given.count, given.seconds, given.keep)
    for fault, times in failures.most_common(20):
        print(f"{times} times {fault}")
    print(f"{done} inputs, {sum(failures.values())} failures")
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    main()
