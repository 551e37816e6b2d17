"""Foreign text on a terminal, in pictures, in tables, and as the names of files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from insonify.names import LONGEST_FILE_NAME_BYTES, csv_cell, figure_text, file_name, plain
from insonify.report.fans import draw_fan
from insonify.types import FanGeometry, Ping


@given(st.text())
def test_nothing_printed_is_obeyed(text: str) -> None:
    shown = plain(text)
    assert shown.isprintable() and len(shown) == len(text)
    assert plain(shown) == shown


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("Wrack Nr. 3 \u00b1 m\u00e5l", "Wrack Nr. 3 \u00b1 m\u00e5l"),
        ("\x1b]0;owned\x07", "?]0;owned?"),
        ("a\nb\tc", "a b c"),
        ("\u202egpj.exe", "?gpj.exe"),
        ("\udcff", "?"),
    ],
)
def test_what_is_shown(text: str, shown: str) -> None:
    assert plain(text) == shown


@given(st.text())
def test_any_text_names_a_file_in_the_folder_that_is_meant(text: str) -> None:
    name = file_name(text)
    folder = Path("/results")
    assert (folder / name).parent == folder and name not in (".", "..")
    assert 0 < len(name.encode()) <= LONGEST_FILE_NAME_BYTES
    assert not name.startswith((".", "-")) and file_name(name) == name


def test_usual_names_stay() -> None:
    for name in ("tetrapod-entropy-seed0", "tank-park-2025", "fly-v\u00e5gen", "a.b_c+d"):
        assert file_name(name) == name
    assert file_name("../../x") == "x" and file_name("") == "unnamed"


def test_a_name_is_no_formula() -> None:
    ping = Ping(np.zeros((4, 3), np.float32), FanGeometry(0.5, 0.2, 3, 4, 0.1, 2.0), 0.0)
    for name in (r"$\nope{$", "$a$b$", r"\$x$"):
        assert draw_fan(ping, name).startswith(b"\x89PNG")
    assert figure_text("5 $") == r"5 \$"
    cells = ["=1+1", "@SUM(A1)", "+x", "-x", " =1", "x", 3, -2.5, ""]
    assert [csv_cell(cell) for cell in cells] == [
        "'=1+1", "'@SUM(A1)", "'+x", "'-x", "' =1", "x", 3, -2.5, ""
    ]  # fmt: skip
