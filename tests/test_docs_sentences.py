"""The sentences of the page on trouble are the program's own."""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from benchmarks.pages import ROOT, blocks

from insonify.cli import main

PAGE = ROOT / "docs/troubleshooting.md"
SENTENCES = re.findall(r"`insonify: ([^`]+)`", PAGE.read_text("utf-8"))
LEAST_OWN = 0.35
"""So much of a sentence, at least, is words of the source and not what is filled in."""


def _template(node: ast.AST) -> list[str | None] | None:
    """A string of the source in parts, None for what is filled in."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return [node.value]
    if isinstance(node, ast.JoinedStr):
        return [p.value if isinstance(p, ast.Constant) else None for p in node.values]  # type: ignore[misc]
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        left, right = _template(node.left), _template(node.right)
        return [*(left or [None]), *(right or [None])]
    return None


@cache
def _templates() -> tuple[tuple[int, re.Pattern[str]], ...]:
    """Every string of the source: how long its own words are, and what it matches."""

    def told() -> Iterator[tuple[int, re.Pattern[str]]]:
        for file in sorted((ROOT / "src/insonify").rglob("*.py")):
            for node in ast.walk(ast.parse(file.read_text("utf-8"))):
                parts = _template(node)
                own = sum(len(part) for part in parts or () if part)
                if parts and own > 12:
                    text = "".join(".+" if p is None else re.escape(_plain(p)) for p in parts)
                    yield own, re.compile(text)

    return tuple(told())


def _plain(text: str) -> str:
    """Quotes of code are marks of the page's own."""
    return text.removeprefix("insonify: ").replace("`", "'")


def _is_told(sentence: str) -> bool:
    text = _plain(sentence)
    beginnings = (text, f"{text} ") if text.endswith("...") else (text,)
    for own, template in _templates():
        if own < LEAST_OWN * len(text):
            continue
        if any(template.fullmatch(beginning) for beginning in beginnings):
            return True
    return False


@pytest.mark.parametrize("sentence", SENTENCES)
def test_a_sentence_is_one_of_the_program(sentence: str) -> None:
    assert _is_told(sentence)


def test_what_the_program_never_says_is_noticed() -> None:
    assert len(SENTENCES) > 25
    for sentence in (
        "FILE: the mesh has no corners; export it with its faces",
        "NAME: NAME",
        "...",
    ):
        assert not _is_told(sentence)


def test_shown_commands_end_as_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (shown,) = [block for block in blocks(PAGE) if block.language == "console"]
    pairs = re.findall(r"^\$ (.+)\n(.+)$", shown.text, re.M)
    assert len(pairs) == 3
    for command, sentence in pairs:
        monkeypatch.setattr(sys, "argv", command.split())
        with pytest.raises(SystemExit) as ended:
            main()
        assert ended.value.code == 2 and capsys.readouterr().err == f"{sentence}\n"
