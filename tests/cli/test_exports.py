"""``insonify export`` as a person types it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from insonify.cli import app
from insonify.errors import InsonifyError
from insonify.io.maps import save_map
from insonify.mapping.voxels import VoxelMap

pytestmark = pytest.mark.slow

MakeMap = Callable[..., VoxelMap]


def _export(*arguments: str) -> str:
    done = CliRunner().invoke(app, ["export", *arguments], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.stdout


@pytest.fixture
def run_folder(tmp_path: Path, make_map: MakeMap, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run").mkdir()
    save_map(make_map(1), tmp_path / "run/map.npz")
    return tmp_path / "run"


def test_export_writes_and_converts_back(run_folder: Path) -> None:
    row = json.loads(_export("run", "m.ot", "--json"))
    assert row["file"] == "m.ot" and row["bytes"] == Path("m.ot").stat().st_size
    assert "observed voxels of 0.1 m" in _export("m.ot", "m.zarr")
    again = json.loads(_export("m.zarr", "n.ot", "--json"))
    assert again["observed_voxels"] == row["observed_voxels"] > row["occupied_voxels"] > 0
    assert Path("m.ot").read_bytes() == Path("n.ot").read_bytes()
    _export("run", "m.tif", "--datum", "54.32,10.13")


def test_export_replaces_only_with_force(run_folder: Path) -> None:
    for name in ("m.zarr", "m.bt"):
        _export("run", name)
        with pytest.raises(InsonifyError, match="--force"):
            _export("run", name)
        _export("run", name, "--force")
    Path("folder.bt").mkdir()
    with pytest.raises(InsonifyError, match="is a folder"):
        _export("run", "folder.bt", "--force")
    assert not [path for path in Path().iterdir() if path.name.startswith(".")]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["none", "m.bt"], "none: there is no such map"),
        (["run", "m.pcd"], r"^m\.pcd: there is no map format"),
        (["run", "none/m.bt"], "none/m.bt: cannot be written"),
        (["run", "m.tif", "--datum", "1;2"], "not '1;2'"),
        (["run", "m.bt", "--datum", "1,2"], r"^m\.bt: only a GeoTIFF"),
        (["run/map.npz", "m"], "no map format ''"),
    ],
)
def test_bad_input(run_folder: Path, arguments: list[str], words: str) -> None:
    with pytest.raises(InsonifyError, match=words):
        _export(*arguments)
    assert [path.name for path in Path().iterdir()] == ["run"]
