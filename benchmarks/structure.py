"""How the code is cut: lengths of functions and files, arguments, repeated lines.

``python -m benchmarks.structure`` prints the table, and the functions and files over the bounds.
Kernels (numba's, which inline what is called in their loops) and the command line's options are
counted apart.
"""

from __future__ import annotations

import ast
import io
import statistics
import tokenize
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

SOURCE = Path("src/insonify")
LONG_FUNCTION, LONG_FILE, MANY_ARGUMENTS, REPEATED = 50, 400, 7, 10


@dataclass(frozen=True, slots=True)
class Function:
    """A function where it stands."""

    place: str
    lines: int
    arguments: int
    kernel: bool


def functions(path: Path) -> list[Function]:
    """All functions of a file."""
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            given = node.args
            names = [a.arg for a in (*given.posonlyargs, *given.args, *given.kwonlyargs)]
            count = len([name for name in names if name not in ("self", "cls")])
            kernel = any("kernel" in ast.dump(decorator) for decorator in node.decorator_list)
            lines = (node.end_lineno or node.lineno) - node.lineno + 1
            place = f"{path.relative_to(SOURCE)}:{node.lineno} {node.name}"
            found.append(Function(place, lines, count, kernel))
    return found


def code_lines(path: Path) -> list[tuple[int, str]]:
    """Lines of a file that hold logic: no comments, docstrings, imports, or lone punctuation."""
    text = path.read_text(encoding="utf-8")
    left_out = set()
    for node in ast.walk(ast.parse(text)):
        docstring = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if docstring or isinstance(node, ast.Import | ast.ImportFrom):
            left_out |= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))  # type: ignore[attr-defined]
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if (
            token.type == tokenize.COMMENT
            and text.splitlines()[token.start[0] - 1].lstrip()[0] == "#"
        ):
            left_out.add(token.start[0])
    return [
        (number, line.strip())
        for number, line in enumerate(text.splitlines(), 1)
        if number not in left_out and any(c.isalnum() for c in line)
    ]


def repeated(paths: list[Path]) -> list[str]:
    """Runs of lines that stand in two places."""
    seen: dict[tuple[str, ...], list[tuple[Path, int]]] = defaultdict(list)
    for path in paths:
        lines = code_lines(path)
        for at in range(len(lines) - REPEATED + 1):
            window = tuple(text for _, text in lines[at : at + REPEATED])
            seen[window].append((path, lines[at][0]))
    pairs: dict[tuple[str, ...], str] = {}
    for places in seen.values():
        if len(places) > 1:
            files = tuple(sorted({str(path.relative_to(SOURCE)) for path, _ in places}))
            pairs.setdefault(files, ", ".join(f"{p.relative_to(SOURCE)}:{n}" for p, n in places))
    return list(pairs.values())


def main() -> None:
    """Print the table."""
    paths = sorted(SOURCE.rglob("*.py"))
    found = [one for path in paths for one in functions(path)]
    lengths = sorted(one.lines for one in found)
    long = [one for one in found if one.lines > LONG_FUNCTION]
    plain = [one for one in long if not one.kernel and not one.place.startswith("cli/")]
    many = [one for one in found if one.arguments > MANY_ARGUMENTS]
    wide = [one for one in many if not one.kernel and not one.place.startswith("cli/")]
    files = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in paths}
    copies = repeated(paths)
    rows = [
        ("functions", len(found)),
        ("length, median", statistics.median(lengths)),
        ("length, 90th percentile", lengths[round(0.9 * (len(lengths) - 1))]),
        ("length, largest", lengths[-1]),
        (f"over {LONG_FUNCTION} lines", len(plain)),
        ("  kernels", sum(one.kernel for one in long)),
        ("  commands, by their options", sum(one.place.startswith("cli/") for one in long)),
        (f"over {MANY_ARGUMENTS} arguments", len(wide)),
        ("  kernels", sum(one.kernel for one in many)),
        ("files", len(files)),
        (f"files over {LONG_FILE} lines", sum(count > LONG_FILE for count in files.values())),
        (f"runs of {REPEATED} lines that stand twice", len(copies)),
    ]
    for name, value in rows:
        print(f"{name:36} {value:g}")
    for one in sorted(long, key=lambda one: -one.lines):
        print(f"  {one.lines:4} lines  {one.place}{'  (kernel)' if one.kernel else ''}")
    for one in wide:
        print(f"  {one.arguments:4} arguments  {one.place}")
    for path, count in files.items():
        if count > LONG_FILE:
            print(f"  {count:4} lines  {path.relative_to(SOURCE)}")
    for copy in copies:
        print(f"  twice: {copy}")


if __name__ == "__main__":
    main()
