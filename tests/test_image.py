"""The Dockerfile holds to the project."""

from __future__ import annotations

import fnmatch
import json
import re
import shlex
import subprocess
import sys
import time
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import typer

from insonify.cli import app
from insonify.cli.live import VIEW_PORT
from insonify.io.heartbeat import Heartbeat, write_heartbeat
from insonify.live.foxglove import PORT

ROOT = Path(__file__).resolve().parents[1]


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


LINES = instructions(ROOT / "Dockerfile")
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
COMMANDS: Any = typer.main.get_command(app)


def all_of(word: str) -> list[Instruction]:
    return [one for one in LINES if one.word == word]


def the(word: str) -> Instruction:
    return all_of(word)[-1]


def arguments() -> dict[str, str]:
    return dict(one.rest.split("=", 1) for one in all_of("ARG"))


def test_every_line_is_read() -> None:
    words = [one.word for one in LINES]
    assert words.count("FROM") == 2 and len(words) > 15
    assert all(re.fullmatch(r"[A-Z]+", word) for word in words)


def test_the_base_is_pythons_own_image_and_a_version_that_is_supported() -> None:
    base = arguments()["PYTHON"]
    match = re.fullmatch(r"python:(3\.\d+)-slim-[a-z]+", base)
    assert match, base
    assert f"Programming Language :: Python :: {match[1]}" in PROJECT["classifiers"]
    assert {one.rest.partition(" AS ")[0] for one in all_of("FROM")} == {"${PYTHON}"}
    text = (ROOT / "Dockerfile").read_text()
    assert "://" not in text and "--index-url" not in text


def test_groups_and_versions_are_the_projects() -> None:
    groups = arguments()["EXTRAS"].split(",")
    assert set(groups) <= set(PROJECT["optional-dependencies"]) and "live" in groups
    installs = [one.rest for one in all_of("RUN") if "pip install" in one.rest]
    assert installs and all("constraints.txt" in rest for rest in installs)


def test_what_is_copied_is_there_and_is_all_that_the_package_is_built_from() -> None:
    kept = context(ROOT / ".dockerignore")
    copied = [
        source for one in all_of("COPY") if "from" not in one.options for source in one.words[:-1]
    ]
    assert set(copied) <= set(kept) <= {*copied, "cyclonedds"}
    needed = {"pyproject.toml", "src", PROJECT["readme"], *PROJECT["license-files"]}
    assert needed | {"constraints.txt"} == set(copied)


def test_nobody_is_root_and_what_is_kept_lies_in_volumes() -> None:
    user = the("USER").rest
    assert user not in ("root", "0") and f"useradd --create-home --uid 1000 {user}" in runs()
    at = LINES.index(the("USER"))
    assert LINES.index(the("ENTRYPOINT")) > at
    assert set(the("VOLUME").words) == {"/data", "/recordings"}
    assert the("WORKDIR").rest in the("VOLUME").words
    for folder in the("VOLUME").words:
        assert re.search(rf"install -d -o {user} .*{folder}\b", runs())


def runs() -> str:
    return "\n".join(one.rest for one in all_of("RUN"))


def test_its_commands_are_commands() -> None:
    assert the("ENTRYPOINT").words == ["insonify"] and "insonify" in PROJECT["scripts"]
    warm_up = re.findall(r"(?:^|&& )insonify (\S+)", runs(), re.MULTILINE)
    assert warm_up == ["warm-up"]
    for name in (*warm_up, the("CMD").words[0]):
        assert name in COMMANDS.commands
    command = COMMANDS.commands[the("CMD").words[0]]
    assert command.make_context("live", the("CMD").words[1:], resilient_parsing=True)


def test_its_ports_are_those_of_the_view_and_of_foxglove() -> None:
    (view,) = (param.default for param in COMMANDS.commands["view"].params if param.name == "port")
    own = {str(view), str(VIEW_PORT), str(PORT)}
    assert set(the("EXPOSE").words) == own


def check(folder: Path) -> subprocess.CompletedProcess[str]:
    """Its health check, here, with a folder in the place of its volume."""
    words = Instruction("CMD", the("HEALTHCHECK").rest.removeprefix("CMD ")).words
    assert words[0] == "insonify" and "/data" in words
    line = [str(folder) if word == "/data" else word for word in words[1:]]
    return subprocess.run(
        [sys.executable, "-m", "insonify", *line], cwd=folder, capture_output=True, text=True,
        check=False,
    )  # fmt: skip


@pytest.mark.slow
def test_its_health_check_tells_a_session_that_maps(tmp_path: Path) -> None:
    assert check(tmp_path).returncode == 1
    new = tmp_path / "insonify-runs" / ".live-abcdefgh" / "new"  # of `live` without --out
    new.mkdir(parents=True)
    now_s = time.monotonic()
    for age_s, well, code in [(0.0, True, 0), (0.0, False, 1), (60.0, True, 1)]:
        write_heartbeat(new, Heartbeat(now_s - age_s, well, "no ping for 9 s", 3, 2))
        shown = check(tmp_path)
        assert shown.returncode == code, shown.stderr
        assert ("no ping for 9 s" in shown.stderr) == (not well)
