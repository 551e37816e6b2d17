from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

import insonify

README = Path(__file__).resolve().parents[1] / "README.md"


@pytest.mark.parametrize("name", insonify.__all__)
def test_every_public_name_is_there(name: str) -> None:
    assert getattr(insonify, name) is not None


def test_unknown_names_are_attribute_errors() -> None:
    with pytest.raises(AttributeError, match="nonesuch"):
        insonify.nonesuch  # noqa: B018


@pytest.mark.parametrize("index", range(2))
def test_the_readmes_python_examples_run(index: int, tmp_path: Path) -> None:
    blocks = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.S)
    assert len(blocks) == 2
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", blocks[index]],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
