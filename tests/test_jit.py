"""The cache of compiled kernels: a change anywhere compiles all anew, and it is said."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

import insonify
from insonify.jit import kernel_sources

pytestmark = pytest.mark.slow

_JIT = Path(__file__).parents[1] / "src/insonify/jit.py"
_INNER = (
    "from insonify.jit import kernel\n\n@kernel\ndef inner(x: float) -> float:\n    return x * {}\n"
)
_OUTER = (
    "from insonify.jit import kernel\nfrom insonify.inner import inner\n\n"
    "@kernel\ndef outer(x: float) -> float:\n    return inner(x) + 1.0\n"
)
_ASK = (
    "import logging; logging.basicConfig(level=logging.INFO, format='%(message)s')\n"
    "from insonify.outer import outer; print(outer(1.0))"
)

_UNCOMPILED = """
import importlib, pkgutil, insonify
from insonify.jit import KERNELS
from insonify.warmup import STEPS, warm_up_step
for module in pkgutil.walk_packages(insonify.__path__, "insonify."):
    if not module.name.endswith("__main__"):
        importlib.import_module(module.name)
for step in STEPS:
    warm_up_step(step)
print(*(kernel.__name__ for kernel in KERNELS if not kernel.signatures))
signatures = {kernel.__name__: len(kernel.signatures) for kernel in KERNELS}
import numpy as np
from pathlib import Path
from insonify.io.recordings import open_recording
from insonify.io.recordings.arrays import save_arrays
from insonify.mapping.factory import MAPPERS, make_mapper
from insonify.mapping.mapper import MappingSettings
from insonify.mission.remap import map_recordings
from insonify.types import FanGeometry, Ping, Pose, PosedPing
fan = FanGeometry(0.5, 0.2, 4, 16, 0.0, 2.0)
ping = Ping(np.ones((16, 4), np.float32), fan)
save_arrays(Path("dive.npz"), [PosedPing(ping, Pose(0.0, 0.0, -3.0))])
for name in MAPPERS:
    settings = MappingSettings()
    mapper = make_mapper(name, settings)
    map_recordings([open_recording(Path("dive.npz"))], settings, mapper=mapper)
print(*(k.__name__ for k in KERNELS if len(k.signatures) > signatures[k.__name__]))
"""

_CONSTANTS = """
import importlib, pkgutil, types, insonify
from insonify.jit import KERNELS
for module in pkgutil.walk_packages(insonify.__path__, "insonify."):
    if not module.name.endswith("__main__"):
        importlib.import_module(module.name)
def names(code):
    yield from code.co_names
    for inner in code.co_consts:
        if isinstance(inner, types.CodeType):
            yield from names(inner)
for kernel in KERNELS:
    known = kernel.py_func.__globals__
    for name in sorted(set(names(kernel.py_func.__code__))):
        value = known.get(name)
        if value is not None and not callable(value) and not isinstance(value, types.ModuleType):
            print(kernel.py_func.__module__, name)
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package with the real `jit`, and two kernels in two files."""
    package = tmp_path / "insonify"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "jit.py").write_text(_JIT.read_text(encoding="utf-8"))
    (package / "inner.py").write_text(_INNER.format("2.0"))
    (package / "outer.py").write_text(_OUTER)
    return package


def _ask(package: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", _ASK],
        cwd=package.parent,
        env=os.environ | {"PYTHONPATH": str(package.parent), **environment},
        capture_output=True,
        text=True,
        check=True,
    )


def test_a_kernel_sees_a_change_in_another_file(package: Path) -> None:
    first, second = _ask(package), _ask(package)
    assert first.stdout == second.stdout == "3.0\n"
    assert "compiling outer" in first.stderr and second.stderr == ""
    (package / "inner.py").write_text(_INNER.format("5.0"))
    changed = _ask(package)
    assert changed.stdout == "6.0\n" and "compiling outer" in changed.stderr


def test_kernels_of_old_sources_go_once_none_can_be_running(package: Path) -> None:
    _ask(package)
    cache = package / "__pycache__"
    [old] = cache.glob("kernels-*")
    (package / "inner.py").write_text(_INNER.format("5.0"))
    _ask(package)
    assert old.exists()
    long_ago = old.stat().st_mtime - 8 * 24 * 3600
    os.utime(old, (long_ago, long_ago))
    _ask(package)
    assert not old.exists() and len(list(cache.glob("kernels-*"))) == 1


def test_no_kernel_takes_a_constant_of_a_file_that_is_not_watched() -> None:
    """What is compiled in would stay as it was when the file changes."""
    watched = {path.resolve() for path in kernel_sources()}
    done = subprocess.run(
        [sys.executable, "-c", _CONSTANTS], capture_output=True, text=True, check=True
    )
    taken = [line.split() for line in done.stdout.splitlines()]
    assert ["insonify.mapping.bayes", "BLOCK"] in taken
    unwatched = []
    for module, name in taken:
        while module:
            path = Path(insonify.__file__).parents[1] / (module.replace(".", "/") + ".py")
            if not path.is_file():
                path = path.with_suffix("") / "__init__.py"
            if path.resolve() not in watched:
                unwatched.append((module, name))
            module = _whence(path, name)
    assert unwatched == []


def _whence(path: Path, name: str) -> str:
    """The module that a file imports a name from, nothing if it does not."""
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.ImportFrom) and name in [a.asname or a.name for a in node.names]:
            return node.module or ""
    return ""


def test_warm_up_leaves_nothing_to_compile(tmp_path: Path) -> None:
    """No kernel, and of those that map a recording no version."""
    done = subprocess.run(
        [sys.executable, "-c", _UNCOMPILED],
        env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == []


def test_the_users_own_folder_is_taken(package: Path, tmp_path: Path) -> None:
    own = tmp_path / "own"
    assert _ask(package, NUMBA_CACHE_DIR=str(own)).stdout == "3.0\n"
    assert list(own.glob("kernels-*/**/*.nbi"))
    assert not list((package / "__pycache__").glob("kernels-*"))


@pytest.mark.skipif(os.geteuid() == 0, reason="root writes everywhere")
def test_where_nothing_can_be_written_it_compiles_each_time(package: Path) -> None:
    (package / "__pycache__").mkdir(exist_ok=True)
    (package / "__pycache__").chmod(0o500)
    done = _ask(package, HOME="/nonexistent", XDG_CACHE_HOME="/nonexistent")
    assert done.stdout == "3.0\n" and "each start compiles them anew" in done.stderr


def test_where_nothing_can_be_written_it_says_so(package: Path) -> None:
    """As root too: the place is a file."""
    (package / "__pycache__").touch()
    done = _ask(package, XDG_CACHE_HOME="/dev/null", PYTHONDONTWRITEBYTECODE="1")
    assert done.stdout == "3.0\n" and "each start compiles them anew" in done.stderr


@pytest.mark.parametrize("own", [{}, {"GOMP_SPINCOUNT": "7"}, {"OMP_WAIT_POLICY": "active"}])
def test_how_threads_wait_is_set_for_our_own_library_only(own: dict[str, str]) -> None:
    """Programs that are started from here, and libraries loaded later, see the user's settings."""
    asked = ("GOMP_SPINCOUNT", "OMP_WAIT_POLICY")
    code = (
        f"import insonify.jit, os; print({{k: os.environ[k] for k in {asked} if k in os.environ}})"
    )
    clean = {name: value for name, value in os.environ.items() if name not in asked}
    told = subprocess.run(
        [sys.executable, "-c", code], env=clean | own, capture_output=True, text=True, check=True
    )
    assert ast.literal_eval(told.stdout) == own
