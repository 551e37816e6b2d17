"""The code that the docs' pages show: examples written into them, commands told from them.

    python -m benchmarks.pages             writes the examples anew into the pages that show them
    python -m benchmarks.pages --not-run   lists the commands that the tests do not run, and why

Marks in comments, which readers of a page do not see, stand before a block:

    <!-- example: examples/01_first_ping.py -->   the block is this file from its first import on
    <!-- file: mine.py -->                        the block is this file, or its next part
    <!-- as: M = map | X Y Z YAW = 0 0 -15 0 -->  what the words of the block stand for
    <!-- first: insonify scan tetrapod -->        run before the block
    <!-- picture: out/ping.png = images/gallery/ping.webp -->
                                                  what the block leaves is this image of the page
    <!-- not run: it takes hours -->              the block is not run, and why
    <!-- not run dask worker: a cluster -->       the lines are not run that begin so
"""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
SHOWN = re.compile(r"<!-- example: (examples/[\w.]+) -->\n```python\n(.*?)^```$", re.M | re.S)
ROOT_FILES = {"changelog.md", "contributing.md"}
"""Pages that are files of the root; they say so to who reads docs/ as it is."""

ELSEWHERE = {
    "pip": "it installs",
    "python -m pip": "it installs",
    "python -m venv": "it installs",
    "make": "it sets up an environment, or runs every check",
    "python3 -m venv": "it installs",
    ".venv/bin/pip": "it installs",
    "git": "it needs a network",
    "docker": "it needs docker",
    "dask": "it starts a cluster",
    "jupyter": "it opens a notebook, which has tests of its own",
    "rerun": "it opens a window",
    "ros2": "it needs ROS 2",
    "python -m benchmarks": "minutes to hours; that the command is there is tested",
}
"""Commands that no test runs, by how they begin."""

OF_OTHERS = {"torch": "it needs PyTorch", "dask_jobqueue": "it needs Slurm"}
"""Modules that no test of Python imports."""

_MARK = re.compile(r"<!-- (example|file|as|first|picture|not run)( [^:]+)?: (.+?) -->")
_BLOCK = re.compile(
    r"((?:^<!-- [^\n]+ -->\n)*)^([ ]*)```(\w*)[^\n]*\n(.*?)^[ ]*```[ ]*$", re.M | re.S
)
_INLINE = re.compile(r"`(insonify [^`]+)`")


@dataclass(frozen=True)
class Block:
    """A block of code on a page.

    Attributes:
        page: Its page, from the project's root.
        line: Where it begins on it, from 1.
        language: As the fence has it.
        text: What it holds.
        marks: What stands before it: kind, what of the block, the words.
    """

    page: str
    line: int
    language: str
    text: str
    marks: tuple[tuple[str, str, str], ...]

    def marked(self, kind: str) -> list[str]:
        """The words of the marks of a kind that hold for the whole block."""
        return [words for found, part, words in self.marks if found == kind and not part]

    @property
    def code_not_run(self) -> str:
        """Why no test runs this block of Python, or nothing."""
        imported = re.findall(r"^(?:from|import) (\w+)", self.text, re.M)
        reasons = [OF_OTHERS[module] for module in imported if module in OF_OTHERS]
        return next(iter([*self.marked("not run"), *reasons]), "")

    def commands(self) -> Iterator[Command]:
        """What one types, line by line."""
        if self.language == "sh":
            for text in _lines(self.text):
                yield Command(self, text, self._stands_for(text), self._why_not(text))

    def _stands_for(self, text: str) -> str:
        for words in self.marked("as"):
            for pair in words.split(" | "):
                name, _, value = pair.partition(" = ")
                text = re.sub(rf"(?<![\w.]){re.escape(name)}(?!\w)", value, text)
        return text

    def _why_not(self, text: str) -> str:
        for found, part, words in self.marks:
            if found == "not run" and text.startswith(part):
                return words
        for start, why in ELSEWHERE.items():
            if re.match(rf"{re.escape(start)}(\s|\.|$)", text):
                return why
        return ""


@dataclass(frozen=True)
class Command:
    """A command as a page shows it.

    Attributes:
        block: Where it stands.
        text: As it is shown, without its comment.
        meant: With what its placeholders stand for.
        not_run: Why no test runs it, or nothing.
    """

    block: Block
    text: str
    meant: str
    not_run: str

    @property
    def words(self) -> list[str]:
        """As the shell takes it apart."""
        return shlex.split(self.meant)


def pages() -> list[Path]:
    """What people read: the README and every page of the docs, the root's own where they stand."""
    docs = [page for page in sorted((ROOT / "docs").rglob("*.md")) if page.name not in ROOT_FILES]
    return [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *docs]


def blocks(page: Path) -> list[Block]:
    """The blocks of a page, in its order."""
    text = page.read_text("utf-8")
    told = []
    for found in _BLOCK.finditer(text):
        marks = tuple((m[1], (m[2] or "").strip(), m[3]) for m in _MARK.finditer(found[1]))
        line = text[: found.start()].count("\n") + 1
        name = page.relative_to(ROOT).as_posix()
        told.append(Block(name, line, found[3], found[4], marks))
    return told


def in_words(page: Path) -> list[str]:
    """The commands that a page names in a sentence or a table."""
    text = _BLOCK.sub("", page.read_text("utf-8"))
    return [" ".join(found.replace("\\|", "|").split()) for found in _INLINE.findall(text)]


def _lines(text: str) -> Iterator[str]:
    """The commands of a block of shell, those over several lines as one, without comments."""
    held = ""
    for line in text.splitlines(keepends=True):
        held += line
        try:
            words = shlex.split(held.replace("\\\n", " "), comments=True)
        except ValueError:  # a quote is still open
            continue
        if not held.endswith("\\\n"):
            if words:
                yield _without_comment(held.replace("\\\n", " ").strip())
            held = ""


def _without_comment(text: str) -> str:
    for place in (found.start() for found in re.finditer(r"\s#\s", text)):
        try:
            shlex.split(text[:place])
        except ValueError:  # within a quote
            continue
        return text[:place].rstrip()
    return text


def shown(name: str) -> str:
    """An example from its first import on, without the words for those who run the file."""
    lines = (ROOT / name).read_text("utf-8").splitlines(keepends=True)
    first = next(k for k, line in enumerate(lines) if line.startswith(("import ", "from ")))
    return "".join(lines[first:])


def with_examples(text: str) -> str:
    """A page with each example that it shows as the file has it."""
    return SHOWN.sub(lambda m: f"<!-- example: {m[1]} -->\n```python\n{shown(m[1])}```", text)


def _list_not_run(shown: list[Block]) -> None:
    for block in shown:
        told = [(command.text, command.not_run) for command in block.commands()]
        if block.language == "python":
            told.append(("a block of Python", block.code_not_run))
        for text, why in told:
            if why:
                print(f"{block.page}:{block.line}: {text}\n    {why}")


def main(words: list[str]) -> int:
    """Write the examples into the pages that show them, or list what is not run."""
    if words not in ([], ["--not-run"]):
        print("usage: python -m benchmarks.pages [--not-run]")
        return 2
    for page in pages():
        if words:
            _list_not_run(blocks(page))
            continue
        before = page.read_text("utf-8")
        after = with_examples(before)
        if after != before:
            page.write_text(after, "utf-8")
            print(f"{page.relative_to(ROOT)}: examples written anew")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
