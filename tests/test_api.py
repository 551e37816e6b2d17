from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

import insonify

pytestmark = pytest.mark.slow

README = Path(__file__).resolve().parents[1] / "README.md"


@pytest.mark.parametrize("name", insonify.__all__)
def test_every_public_name_is_there(name: str) -> None:
    assert getattr(insonify, name) is not None


def test_unknown_names_are_attribute_errors() -> None:
    with pytest.raises(AttributeError, match="nonesuch"):
        insonify.nonesuch  # noqa: B018


def _blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README.read_text(encoding="utf-8"), re.S)


def test_the_readmes_python_examples_run(tmp_path: Path) -> None:
    first, *own = _blocks("python")
    assert len(own) == 2
    for block in (first, *own):
        done = subprocess.run(
            [sys.executable, "-W", "error", "-c", block],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr


def test_the_readmes_planner_and_mapper_are_short_and_run_from_the_command_line(
    tmp_path: Path,
) -> None:
    own = _blocks("python")[1:]
    for block in own:
        body = [line for line in block[block.index("class ") :].splitlines() if line.strip()]
        assert len(body) < 10
    (tmp_path / "mine.py").write_text("\n".join(own))
    shell = "\n".join(_blocks("sh"))
    (scan,) = re.findall(r"insonify (scan .*--mapper mine.py:Wary)", shell)
    (compare,) = re.findall(r"insonify (compare .*--planner mine.py:Cross) --seeds 3", shell)
    quick = ["--set", "mapping.voxel_m=0.25", "--set", "survey.waypoints=6", "--json"]
    results = []
    for words in (scan.split(), [*compare.split(), "--seeds", "1"]):
        done = subprocess.run(
            [sys.executable, "-m", "insonify", *words, *quick],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        results.append(json.loads(done.stdout))
    assert (results[0]["planner"], results[0]["mapper"]) == ("cross", "wary")
    assert results[0]["scans"] == 2
    planners = [run["planner"] for run in results[1]["runs"]]
    assert planners == ["entropy", str(tmp_path / "mine.py") + ":Cross"]
