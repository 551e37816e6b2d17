"""The house's import rules, the truth firewall, and how kernels are made."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import insonify

SOURCE = Path(insonify.__file__).parent

# from left to right: a room imports only from rooms before it
LAYERS = [
    "errors",
    "limits",
    "extras",
    "display",
    "types",
    "names",
    "pictures",
    "seeds",
    "memory",
    "jit",
    "kernels",
    "frames",
    "config",
    "plugins",
    "scene",
    "sonar",
    "mapping",
    "planning",
    "vehicle",
    "evaluation",
    "io",
    "imaging",
    "mission",
    "gym",
    "report",
    "results",
    "view",
    "doctor",
    "live",
    "warmup",
    "cli",
    "__main__",
]
FIREWALL: dict[tuple[str, ...], set[tuple[str, ...]]] = {
    ("mapping",): {("scene",), ("sonar",), ("evaluation",), ("vehicle", "plant")},
    ("planning",): {("scene",), ("sonar",), ("evaluation",), ("vehicle", "plant")},
    ("vehicle",): {("scene",), ("evaluation",)},
    ("vehicle", "autopilot"): {("scene",), ("evaluation",), ("vehicle", "plant")},
}
"""What a room that decides never reaches, directly or through others."""


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


def _inside(path: Path, room: tuple[str, ...]) -> bool:
    parts = path.relative_to(SOURCE).with_suffix("").parts
    return parts[: len(room)] == room


@pytest.mark.parametrize(
    "room", sorted(FIREWALL), ids=["/".join(room) for room in sorted(FIREWALL)]
)
def test_what_decides_never_sees_the_truth(room: tuple[str, ...]) -> None:
    def reachable(path: Path, seen: set[Path]) -> set[Path]:
        for name in _imports(path):
            for file in _module_files(name):
                if file not in seen:
                    seen.add(file)
                    reachable(file, seen)
        return seen

    deciders = [path for path in FILES if _inside(path, room)]
    assert deciders
    for path in deciders:
        for other in reachable(path, set()):
            crossed = [forbidden for forbidden in FIREWALL[room] if _inside(other, forbidden)]
            assert not crossed, f"{path.name} reaches {other.relative_to(SOURCE)}"


def test_kernels_are_made_in_one_way() -> None:
    """By `insonify.jit`, which keys the cache on all of them."""
    for path in FILES:
        if path.name != "jit.py":
            text = path.read_text(encoding="utf-8")
            assert "njit" not in text and "numba.jit" not in text, path


def test_the_library_does_not_print() -> None:
    for path in FILES:
        if _room(path) not in {"cli", "__main__"}:
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                called = isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
                assert not (called and node.func.id == "print"), path  # type: ignore[attr-defined]


def test_no_rooms_without_a_subject() -> None:
    banned = {"utils", "util", "tools", "helpers", "common", "misc"}
    assert not {path.stem for path in FILES} & banned
