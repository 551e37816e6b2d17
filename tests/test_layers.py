"""The house's import rules, the truth firewall, and the rule of the kernels' cache."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import insonify

SOURCE = Path(insonify.__file__).parent

# from left to right: a room imports only from rooms before it
LAYERS = [
    "errors",
    "types",
    "jit",
    "frames",
    "scene",
    "sonar",
    "mapping",
    "planning",
    "vehicle",
    "mission",
    "evaluation",
    "scenarios",
    "simulation",
    "tours",
    "datasets",
    "runs",
    "comparison",
    "io",
    "replay",
    "report",
    "view",
    "cli",
    "__main__",
]
DECIDERS = ("mapping", "planning", "vehicle")
TRUTH = {"scene", "evaluation"}


def _room(path: Path) -> str:
    part = path.relative_to(SOURCE).parts[0]
    return part.removesuffix(".py")


def _imports(path: Path) -> set[str]:
    """Every module of the project that a file imports, lazily or not, types included."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return {name for name in found if name.split(".")[0] == "insonify" and "." in name}


FILES = sorted(path for path in SOURCE.rglob("*.py") if path != SOURCE / "__init__.py")


def test_every_room_has_its_place() -> None:
    assert {_room(path) for path in FILES} == set(LAYERS)


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(SOURCE)))
def test_imports_only_from_the_left(path: Path) -> None:
    room = _room(path)
    for name in _imports(path):
        other = name.split(".")[1]
        if other.startswith("__version"):
            continue
        assert LAYERS.index(other) <= LAYERS.index(room), f"{path.name} imports {name}"


def _module_files(name: str) -> list[Path]:
    base = SOURCE.joinpath(*name.split(".")[1:])
    return [p for p in (base.with_suffix(".py"), base / "__init__.py") if p.is_file()]


def test_no_cycles_even_inside_a_room() -> None:
    graph = {
        path: {file for name in _imports(path) for file in _module_files(name)} - {path}
        for path in FILES
    }
    done: set[Path] = set()

    def visit(path: Path, trail: tuple[Path, ...]) -> None:
        assert path not in trail, " -> ".join(p.name for p in (*trail, path))
        if path not in done:
            for other in graph.get(path, ()):
                visit(other, (*trail, path))
            done.add(path)

    for path in FILES:
        visit(path, ())


def test_what_decides_never_sees_the_truth() -> None:
    def reachable(path: Path, seen: set[Path]) -> set[Path]:
        for name in _imports(path):
            for file in _module_files(name):
                if file not in seen:
                    seen.add(file)
                    reachable(file, seen)
        return seen

    for path in FILES:
        if _room(path) in DECIDERS:
            rooms = {_room(other) for other in reachable(path, set())}
            assert not rooms & TRUTH, f"{path.name} reaches {rooms & TRUTH}"


def _kernels(path: Path) -> dict[str, ast.FunctionDef]:
    return {
        node.name: node
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef)
        and any(
            isinstance(d, ast.Name) and d.id in {"kernel", "parallel_kernel"}
            for d in node.decorator_list
        )
    }


def test_kernels_call_no_kernel_of_another_file() -> None:
    """Numba's cache would not notice that the other file has changed."""
    kernels = {path: _kernels(path) for path in FILES}
    assert sum(map(len, kernels.values())) > 10
    for path, own in kernels.items():
        foreign = {name for other, names in kernels.items() if other != path for name in names}
        for name, node in own.items():
            called = {
                call.func.id
                for call in ast.walk(node)
                if isinstance(call, ast.Call) and isinstance(call.func, ast.Name)
            }
            assert not called & (foreign - set(own)), f"{path.name}: {name}"


def test_no_rooms_without_a_subject() -> None:
    banned = {"utils", "util", "tools", "helpers", "common", "misc"}
    assert not {path.stem for path in FILES} & banned
