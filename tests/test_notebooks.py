"""The notebooks, run as a reader runs them."""

from __future__ import annotations

import io
import json
import os
import re
import shutil
import subprocess
import sys
from base64 import b64decode
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "examples").glob("*.ipynb"))


def _run(name: str, folder: Path) -> dict[str, Any]:
    """A notebook after all of its cells, in an empty folder."""
    path = folder / f"{name}.ipynb"  # it runs where it lies
    shutil.copy(ROOT / "examples" / path.name, path)
    done = subprocess.run(
        [sys.executable, "-m", "jupyter", "execute", "--inplace", str(path)],
        cwd=folder, capture_output=True, text=True, check=False,
        env=os.environ | {"IPYTHONDIR": str(folder / "i"), "JUPYTER_CONFIG_DIR": str(folder / "j")},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return dict(json.loads(path.read_text(encoding="utf-8")))


def _outputs(notebook: dict[str, Any]) -> list[dict[str, Any]]:
    return [out for cell in notebook["cells"] for out in cell.get("outputs", [])]


def _said(notebook: dict[str, Any]) -> str:
    """What it printed; nothing is warned of."""
    streams = [out for out in _outputs(notebook) if out["output_type"] == "stream"]
    assert [out["text"] for out in streams if out["name"] == "stderr"] == []
    return "".join("".join(out["text"]) for out in streams)


def _pictures(notebook: dict[str, Any]) -> int:
    """How many pictures it shows, none of them blank."""
    found = []
    for out in _outputs(notebook):
        data = out.get("data", {})
        found += re.findall(r"base64,([\w+/=]+)", "".join(data.get("text/html", "")))
        found += ["".join(data["image/png"])] if "image/png" in data else []
    for one in found:
        picture = Image.open(io.BytesIO(b64decode(one))).convert("L")
        assert len(np.unique(np.asarray(picture))) > 20
    return len(found)


def test_scan_and_score(tmp_path: Path) -> None:
    notebook = _run("scan_and_score", tmp_path)
    scores = [float(score) for score in re.findall(r"F1 ([\d.]+)", _said(notebook))]
    assert len(scores) >= 2 and scores[-1] > scores[0] > 0.3
    assert _pictures(notebook) == 4
    assert _outputs(notebook)[-1]["data"]["text/plain"] == ["True"]


def test_own_sonar_and_dataset(tmp_path: Path) -> None:
    notebook = _run("own_sonar_and_dataset", tmp_path)
    assert len(re.findall(r"(?:train|val|test): 4 views of ", _said(notebook))) == 3
    assert _pictures(notebook) == 4
    assert (tmp_path / "insonify-runs/notebook-views/README.md").is_file()


def test_recorded_dive(tmp_path: Path) -> None:
    notebook = _run("recorded_dive", tmp_path)
    said = _said(notebook)
    assert "MCAP (ROS 2): 48 pings" in said and "nothing speaks against it" in said
    assert _pictures(notebook) == 4


def test_campaign(tmp_path: Path) -> None:
    notebook = _run("campaign", tmp_path)
    said = _said(notebook)
    assert "6 of 6 runs are flown" in said
    assert re.search(r"entropy - uniform: F1 [+-]0\.\d+ .* p = [\d.]+ with 3 seeds", said)
    assert _pictures(notebook) == 2


def test_the_page_about_them_says_what_is_so(tmp_path: Path) -> None:
    page = (ROOT / "docs/notebooks.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", block],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert 0.0 < float(done.stdout) < 1.0
    assert {path.name for path in tmp_path.iterdir()} == {"run.png", "map.png"}
    assert all(path.name in page for path in NOTEBOOKS)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_they_are_kept_without_what_they_print_and_link_to_what_is_there(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    notebook = json.loads(text)
    assert text == json.dumps(notebook, indent=1, ensure_ascii=False) + "\n"
    assert set(notebook["metadata"]) == {"kernelspec", "language_info"}
    words = 0
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == [] and cell["execution_count"] is None
        else:
            words += len(" ".join(cell["source"]).split())
    assert words > 100
    for link in re.findall(r"\]\((?!https?:)([^)]+)\)", text):
        assert (path.parent / link).is_file(), link


def test_there_are_four() -> None:
    names = ["campaign", "own_sonar_and_dataset", "recorded_dive", "scan_and_score"]
    assert [path.stem for path in NOTEBOOKS] == names
