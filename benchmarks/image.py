"""The Dockerfile without Docker: ``sudo python -m benchmarks.image [--python PREFIX]``.

Each stage becomes a copy-on-write copy of this machine's files (overlayfs, in a mount namespace of
its own), with this Python or that at PREFIX in the place of the base image's; the stage's lines run
there as they are written, by the user they name.  Then a session is run in the last one, by the
image's user and by one whom it does not know, and the health check must tell it from none.  That
shows that the lines work, and what a user may write; not what Debian's slim image lacks and this
machine has.
"""

from __future__ import annotations

import argparse
import fnmatch
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from insonify.io.recordings.arrays import save_arrays
from insonify.types import FanGeometry, Ping, Pose, PosedPing

ROOT = Path(__file__).resolve().parents[1]
_PASSED = ("PIP_", "HTTP", "HTTPS", "http", "SSL_", "REQUESTS_", "NO_PROXY", "no_proxy")
"""Of this environment, what packages are fetched by."""


@dataclass(frozen=True, slots=True)
class Instruction:
    """A line of a Dockerfile: its word, its options, and the rest."""

    word: str
    rest: str
    options: dict[str, str] = field(default_factory=dict)

    @property
    def words(self) -> list[str]:
        """The rest as words; those of the JSON form are as they are."""
        if self.rest.startswith("["):
            return [str(one) for one in json.loads(self.rest)]
        return shlex.split(self.rest)


def instructions(path: Path) -> list[Instruction]:
    """The instructions of a Dockerfile."""
    lines = [one for one in path.read_text("utf-8").splitlines() if not one.startswith("#")]
    text = re.sub(r"\\\n", " ", "\n".join(lines))
    found = []
    for line in filter(None, map(str.strip, text.splitlines())):
        word, _, rest = line.partition(" ")
        options = {}
        while match := re.match(r"\s*--([a-z-]+)=(\S+)\s+", rest):
            options[match[1]] = match[2]
            rest = rest[match.end() :]
        found.append(Instruction(word, rest.strip(), options))
    return found


def context(ignore: Path) -> list[str]:
    """Names at the top of the context that are not ignored (``*`` and then ``!NAME``)."""
    rules = [one for one in ignore.read_text("utf-8").splitlines() if one[:1] not in ("", "#")]
    found = []
    for path in sorted(ignore.parent.iterdir()):
        kept = True
        for rule in rules:
            if fnmatch.fnmatch(path.name, rule.lstrip("!")):
                kept = rule.startswith("!")
        if kept:
            found.append(path.name)
    return found


@dataclass(slots=True)
class Stage:
    """A stage that is built.

    Attributes:
        root: Its files.
        environment: What is set in it.
        user: Who runs its lines.
        folder: Where.
    """

    root: Path
    environment: dict[str, str]
    user: str = "root"
    folder: str = "/"

    def run(self, *command: str, user: str = "") -> subprocess.CompletedProcess[str]:
        """Run a command in it; its output goes where ours does unless it ends badly."""
        line = ["chroot", f"--userspec={user or self.user}", str(self.root), "/bin/sh", "-c"]
        passed = {k: v for k, v in os.environ.items() if k.startswith(_PASSED)}
        inner = f"cd {shlex.quote(self.folder)} && {shlex.join(command)}"
        return subprocess.run(
            [*line, inner], env=passed | self.environment, text=True, capture_output=True,
            check=False,
        )  # fmt: skip

    def copy(self, source: Path, target: str) -> None:
        """Copy a file, or what is in a folder."""
        place = self.root / Path(self.folder, target).as_posix().lstrip("/")
        if source.is_dir():
            left = shutil.ignore_patterns("__pycache__", "*.egg-info")
            shutil.copytree(source, place, symlinks=True, dirs_exist_ok=True, ignore=left)
        else:
            shutil.copy2(source, place / source.name if place.is_dir() else place)


def begin(home: Path, name: str, prefix: Path) -> Stage:
    """A copy-on-write copy of this machine, with a Python that everyone may run."""
    place = home / name
    for part in ("up", "work", "root"):
        (place / part).mkdir(parents=True)
    told = f"lowerdir=/,upperdir={place / 'up'},workdir={place / 'work'}"
    root = place / "root"
    _must("mount", "-t", "overlay", "overlay", "-o", told, str(root))
    _must("mount", "-t", "proc", "proc", str(root / "proc"))
    _must("mount", "-t", "tmpfs", "tmpfs", str(root / "dev"))  # never the machine's own
    for name, minor in {"null": 3, "zero": 5, "random": 8, "urandom": 9}.items():
        _must("mknod", "-m", "666", str(root / "dev" / name), "c", "1", str(minor))
    (root / "dev/shm").mkdir()
    (root / "dev/shm").chmod(0o1777)
    for name in ("passwd", "group"):  # the base image has none of this machine's people
        file = root / "etc" / name
        kept = (line for line in file.read_text().splitlines() if not _is_person(line))
        file.write_text("\n".join(kept) + "\n")
    shutil.copytree(prefix, root / "opt/python", symlinks=True)
    _must("chmod", "-R", "a+rX", str(root / "opt/python"))
    (root / "etc/ld.so.conf.d/python.conf").write_text("/opt/python/lib\n")
    _must("chroot", str(root), "ldconfig")
    path = "/opt/python/bin:/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
    return Stage(root, {"PATH": path, "HOME": "/root"})


def build(home: Path, prefix: Path) -> Stage:
    """Build all stages; the last."""
    arguments: dict[str, str] = {}
    stages: dict[str, Stage] = {}
    stage: Stage | None = None
    for one in instructions(ROOT / "Dockerfile"):
        print(f"{one.word} {one.rest}"[:100], flush=True)
        if one.word == "ARG":
            name, _, value = one.rest.partition("=")
            arguments[name] = value
            continue
        if one.word == "FROM":
            name = one.rest.partition(" AS ")[2] or "last"
            stage = stages[name] = begin(home, name, prefix)
            continue
        assert stage is not None
        follow(stage, stages, one, arguments)
    assert stage is not None
    return stage


def follow(
    stage: Stage, stages: dict[str, Stage], one: Instruction, arguments: dict[str, str]
) -> None:
    """Do what an instruction says."""
    if one.word == "RUN":
        if "mount" in one.options:
            target = one.options["mount"].rpartition("=")[2]
            (stage.root / target.lstrip("/")).mkdir()
        before = dict(stage.environment)
        stage.environment |= arguments if stage.user == "root" else {}
        done = stage.run("/bin/sh", "-c", one.rest)
        stage.environment = before
        if done.returncode:
            raise SystemExit(f"exit {done.returncode}\n{done.stdout}{done.stderr}")
    elif one.word == "COPY":
        *sources, target = one.words
        for source in sources:
            if "from" in one.options:
                stage.copy(stages[one.options["from"]].root / source.lstrip("/"), target)
            else:
                assert source in context(ROOT / ".dockerignore"), source
                stage.copy(ROOT / source, target)
    elif one.word == "ENV":
        for word in one.words:
            name, _, value = word.partition("=")
            stage.environment[name] = value.replace("$PATH", stage.environment["PATH"])
    elif one.word == "USER":
        stage.user = one.rest
        stage.environment["HOME"] = f"/home/{one.rest}"
    elif one.word == "WORKDIR":
        stage.folder = one.rest
        (stage.root / one.rest.lstrip("/")).mkdir(exist_ok=True)


def try_session(stage: Stage, user: str, recording: str, health: list[str]) -> None:
    """Run a session by a user; the health check must know when there is one."""
    before = stage.run(*health, user=user)
    assert before.returncode == 1, before.stdout + before.stderr
    words = ["insonify", "live", "--from", recording, "--rate", "1", "--out", f"as-{user}"]
    begun = stage.run(
        "/bin/sh", "-c",
        f"{shlex.join(words)} > /tmp/said-{user.replace(':', '-')} 2>&1 & echo $!", user=user,
    )  # fmt: skip
    until = time.monotonic() + 120.0
    while (shown := stage.run(*health, user=user)).returncode:
        assert time.monotonic() < until, shown.stderr
        time.sleep(0.5)
    print(f"{user}: {next(line for line in shown.stdout.splitlines() if 'live' in line)}")
    stage.run("/bin/kill", "-TERM", begun.stdout.strip(), user=user)
    result = stage.root / stage.folder.lstrip("/") / f"as-{user}" / "map.npz"
    while not result.is_file():
        assert time.monotonic() < until, user
        time.sleep(0.5)
    said = (stage.root / f"tmp/said-{user.replace(':', '-')}").read_text()
    assert "compiling" not in said and "warning" not in said.lower(), said


def inside(home: Path, prefix: Path) -> None:
    """Build it and try it, where mounts are this process's own."""
    stage = build(home, prefix)
    fan = FanGeometry(0.7, 0.2, 8, 16, 0.2, 2.0)
    image = np.ones((16, 8), np.float32)
    times = [0.5 * k for k in range(400)]
    pings = [PosedPing(Ping(image, fan, t), Pose(0.1 * t, 0.0, -3.0)) for t in times]
    save_arrays(stage.root / "recordings/dive.npz", pings)
    (health,) = (i for i in instructions(ROOT / "Dockerfile") if i.word == "HEALTHCHECK")
    check = json.loads(health.rest.removeprefix("CMD "))
    (stage.root / "data").chmod(0o777)  # as a folder of the other user's that is mounted there
    for user in (stage.user, "4242:4242"):
        try_session(stage, user, "/recordings/dive.npz", check)
    files = (one for one in stage.root.glob("opt/insonify/**/*") if not one.is_symlink())
    size = sum(one.stat().st_size for one in files if one.is_file())
    print(f"/opt/insonify: {size / 1e6:.0f} MB")


def main() -> None:
    """Begin it in a mount namespace; what it leaves is removed where nothing is mounted."""
    parser = argparse.ArgumentParser(description="The Dockerfile's lines, without Docker.")
    parser.add_argument("--python", type=Path, default=Path(sys.base_prefix))
    parser.add_argument("--inside", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.inside is not None:
        inside(options.inside, options.python)
        return
    with tempfile.TemporaryDirectory() as folder:
        line = ["unshare", "--mount", sys.executable, "-m", "benchmarks.image"]
        more = ["--python", str(options.python), "--inside", folder]
        done = subprocess.run([*line, *more], check=False)
    sys.exit(done.returncode)


def _is_person(line: str) -> bool:
    return 1000 <= int(line.split(":")[2]) < 65534


def _must(*command: str) -> None:
    subprocess.run(command, check=True)


if __name__ == "__main__":
    main()
