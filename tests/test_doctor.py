"""What the machine has: true on this one, and told where something lacks."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import socket
import subprocess
import sys
import tomllib
from collections.abc import Callable
from importlib.metadata import packages_distributions
from pathlib import Path
from typing import Any

import pytest

from insonify.doctor import EXTRAS, Finding, examine
from insonify.errors import RendererError


@pytest.fixture
def found(tmp_path: Path) -> Callable[[], dict[str, Finding]]:
    return lambda: {one.what: one for one in examine(tmp_path / "not" / "yet")}


def test_it_says_what_there_is_and_sends_nothing(
    found: Callable[[], dict[str, Finding]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def opened(*words: Any, **more: Any) -> Any:
        raise AssertionError("a socket was opened")

    monkeypatch.setattr(socket.socket, "connect", opened)
    monkeypatch.setattr(socket.socket, "sendto", opened)
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    told = found()
    assert f"Python {sys.version.split()[0]}" in told["versions"].told
    assert str(os.cpu_count()) in told["threads"].told
    assert told["DDS"].told.startswith("domain 7")
    assert str(tmp_path) in told["disk"].told and not told["disk"].fault
    assert "lo" in told["interfaces"].told


def test_each_fault_has_its_remedy(
    found: Callable[[], dict[str, Finding]], monkeypatch: pytest.MonkeyPatch
) -> None:
    real = importlib.util.find_spec
    gone = {"embreex", "cyclonedds", "moderngl"}
    monkeypatch.setattr(
        "insonify.doctor.find_spec", lambda name: None if name in gone else real(name)
    )
    monkeypatch.setattr("insonify.sonar.gpu.open_context", no_egl)
    monkeypatch.setattr("insonify.memory.free_bytes", lambda: 1000)
    monkeypatch.setenv("ROS_DOMAIN_ID", "home")
    told = found()
    assert "insonify[simulation]" in told["Embree"].remedy
    assert told["OpenGL"].fault == "there is no OpenGL"
    assert "simulation, live, opengl" in told["extras"].fault
    assert "'home'" in told["DDS"].fault
    assert "--voxel" in told["memory"].remedy
    monkeypatch.setenv("ROS_DOMAIN_ID", "0")
    assert "insonify[live]" in found()["DDS"].remedy
    gone.remove("cyclonedds")
    monkeypatch.setenv("CYCLONEDDS_URI", "file:///nowhere/dds.xml")
    assert "/nowhere/dds.xml" in found()["DDS"].fault


def test_every_group_of_libraries_is_looked_for() -> None:
    """By what its packages install; those of who works on insonify itself are not."""
    project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())["project"]
    groups = project["optional-dependencies"]
    assert set(EXTRAS) == set(groups) - {"dev", "docs"}
    installed_by = packages_distributions()
    for name, modules in EXTRAS.items():
        asked = {normal(re.split(r"[><;\[ ]", text)[0]) for text in groups[name]}
        found = {normal(one) for module in modules for one in installed_by.get(module, [module])}
        assert found == asked, name


def normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def no_egl() -> Any:
    raise RendererError("there is no OpenGL")


@pytest.mark.slow
def test_the_command(tmp_path: Path) -> None:
    line = [sys.executable, "-m", "insonify", "doctor"]
    shown = subprocess.run(line, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert "kernels" in shown.stdout and shown.stderr.startswith("insonify: ")
    told = subprocess.run(
        [*line, "--json"], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert {one["what"] for one in json.loads(told.stdout)} >= {"versions", "DDS", "disk"}


@pytest.mark.slow
def test_the_command_without_egl_and_embree(tmp_path: Path) -> None:
    """As where neither is installed: each is named with what to do, and it ends well."""
    code = (
        "import sys\nfor name in ('embreex', 'glcontext'): sys.modules[name] = None\n"
        "sys.argv = ['insonify', 'doctor', '--json']\n"
        "from insonify.cli import main\nmain()\n"
    )
    told = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    found = {one["what"]: one for one in json.loads(told.stdout)}
    assert "insonify[simulation]" in found["Embree"]["remedy"]
    assert (
        "there is no OpenGL" in found["OpenGL"]["fault"] and "libegl1" in found["OpenGL"]["fault"]
    )
    assert "simulation" in found["extras"]["fault"]
    assert not found["kernels"]["fault"] and not found["disk"]["fault"]
