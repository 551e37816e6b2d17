"""Datasets on the disk: what other programs read of them, and what a kill leaves."""

from __future__ import annotations

import json
import logging
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
import xarray
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from PIL import Image
from pycocotools import mask as cocomask
from pycocotools.coco import COCO
from typer.testing import CliRunner

from insonify.cli import app
from insonify.errors import ConfigError, InsonifyError, OutputError
from insonify.imaging.dataset import Shots, dataset_config
from insonify.io.recordings import open_recording
from insonify.results.dataset import write_dataset
from insonify.results.dataset.coco import run_lengths
from insonify.scene.named import named_scene
from insonify.types import Array

pytestmark = pytest.mark.slow

SMALL = ["--set", "sonar.beams=16", "--set", "sonar.bins=32", "--set", "sonar.range_max_m=25"]
COUNT = 6
pycocotools_of_old = pytest.mark.filterwarnings("ignore:__array__ implementation doesn't accept")


def _make(folder: Path, *more: str) -> dict[str, Any]:
    command = ["dataset", "structures", *SMALL, "--out", str(folder), "--json", *more]
    done = CliRunner().invoke(app, command, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return dict(json.loads(done.stdout))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("dataset") / "d"
    _make(path, "--count", str(COUNT), "--workers", "1")
    return path


def _contents(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_the_folder(folder: Path) -> None:
    names = {path.name for path in folder.iterdir()}
    assert names == {
        "README.md", "annotations.json", "config.toml", "dataset.zarr", "images", "masks",
        "result.json", "statistics.png",
    }  # fmt: skip
    assert len(list((folder / "images").iterdir())) == COUNT


def test_xarray_opens_it(folder: Path) -> None:
    store = xarray.open_zarr(folder / "dataset.zarr")
    config = dataset_config("structures", [{"sonar": {"beams": 16, "bins": 32, "range_max_m": 25}}])
    shots = Shots(config, named_scene("structures"))
    assert dict(store.sizes) == {"view": COUNT, "bin": 32, "beam": 16}
    assert store.attrs["labels"] == list(shots.scene.labels)
    assert {"x_m", "yaw_rad", "azimuth_rad", "bin_range_m", "view"} <= set(store.coords)
    np.testing.assert_array_equal(store.bin_range_m, shots.geometry.bin_ranges_m)
    np.testing.assert_array_equal(store.azimuth_rad, shots.geometry.beam_azimuths_rad)
    shot = shots.shot(3)
    assert shot.truth is not None and shot.posed.pose is not None
    here = store.isel(view=3)
    np.testing.assert_array_equal(here.image, shot.posed.ping.image)
    for name in ("label", "elevation_rad", "range_m", "first_return", "shadow"):
        np.testing.assert_array_equal(here[name], getattr(shot.truth, name))
    assert (float(here.x_m), float(here.pitch_rad)) == (
        shot.posed.pose.x_m,
        shot.posed.pose.pitch_rad,
    )
    assert store.elevation_rad.attrs["units"] == "rad"


@pycocotools_of_old
def test_coco_reads_its_annotations(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    coco = COCO(str(folder / "annotations.json"))
    capsys.readouterr()
    store = xarray.open_zarr(folder / "dataset.zarr")
    names = [entry["name"] for entry in coco.loadCats(coco.getCatIds())]
    assert names == [*store.attrs["labels"], "shadow"]
    assert len(coco.getImgIds()) == COUNT
    seen = 0
    for number in coco.getImgIds():
        about = coco.loadImgs([number])[0]
        picture = np.asarray(Image.open(folder / about["file_name"]))
        assert picture.shape == (about["height"], about["width"]) == (32, 16)
        image = store.image[number].values
        np.testing.assert_allclose(picture / 255.0, image, atol=0.5 / 255 + 1e-6)
        mask = np.asarray(Image.open(folder / "masks" / f"{number:06d}.png"))
        label, shadow = store.label[number].values, store.shadow[number].values
        for note in coco.loadAnns(coco.getAnnIds(imgIds=[number])):
            pixels = coco.annToMask(note).astype(bool)
            category = note["category_id"]
            wanted = shadow if category == len(names) else (label == category - 1) & ~shadow
            np.testing.assert_array_equal(pixels, wanted)
            np.testing.assert_array_equal(mask == category, wanted)
            assert note["area"] == wanted.sum() > 0
            runs = cocomask.frPyObjects(note["segmentation"], *pixels.shape)
            assert list(cocomask.toBbox(runs)) == note["bbox"]
            seen += 1
    assert seen > COUNT


@pycocotools_of_old
@given(arrays.arrays(np.bool_, st.tuples(st.integers(1, 9), st.integers(1, 9))))
def test_run_lengths_are_coco_s(mask: Array) -> None:
    counts = run_lengths(mask)
    assert sum(counts) == mask.size
    runs = cocomask.frPyObjects({"size": list(mask.shape), "counts": counts}, *mask.shape)
    np.testing.assert_array_equal(cocomask.decode(runs).astype(bool), mask)


def test_more_processes_make_the_same_files(folder: Path, tmp_path: Path) -> None:
    result = _make(tmp_path / "d", "--count", str(COUNT), "--workers", "2")
    assert _contents(tmp_path / "d") == _contents(folder)
    assert result["views"] == COUNT
    assert result["categories"]["seabed"]["views"] == COUNT


def test_the_first_views_of_more_are_the_same(folder: Path, tmp_path: Path) -> None:
    _make(tmp_path / "d", "--count", "2", "--workers", "1")
    for name in ("images/000001.png", "masks/000001.png", "dataset.zarr/label/c/1/0/0"):
        assert (tmp_path / "d" / name).read_bytes() == (folder / name).read_bytes()


def test_a_killed_dataset_goes_on_where_it_was(folder: Path, tmp_path: Path) -> None:
    target = tmp_path / "d"
    command = [sys.executable, "-m", "insonify", "dataset", "structures", *SMALL]
    command += ["--out", str(target), "--count", str(COUNT), "--workers", "1"]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as process:
        limit = time.monotonic() + 60.0
        while len(list(tmp_path.glob(".d-*/new/done/00000?.json"))) < 2:
            assert process.poll() is None and time.monotonic() < limit
            time.sleep(0.005)
        process.send_signal(signal.SIGKILL)
    (left,) = tmp_path.glob(".d-*")
    whole = sorted(path.name for path in (left / "new/done").glob("*.json"))
    assert len(whole) >= 2
    (left / "new/dataset.zarr" / "image" / "c" / "0" / "0" / "0.abc.partial").write_bytes(b"half")
    before = (left / "new/images/000000.png").stat().st_ino
    _make(target, "--count", str(COUNT), "--workers", "1")
    assert _contents(target) == _contents(folder)
    assert (target / "images" / "000000.png").stat().st_ino == before, "it began anew"
    assert list(tmp_path.iterdir()) == [target]


def test_a_full_disk_keeps_what_is_whole(
    folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.INFO, "insonify")

    def write(path: Path, data: bytes) -> None:
        if path.name == "000003.png":
            raise OutputError(f"{path}: cannot be written (no space left on device)")
        path.write_bytes(data)

    monkeypatch.setattr("insonify.results.dataset.write_file", write)
    words = ["dataset", "structures", *SMALL, "--out", str(tmp_path / "d")]
    words += ["--count", str(COUNT), "--workers", "1"]
    done = CliRunner().invoke(app, words)
    assert isinstance(done.exception, OutputError)
    assert f"stopped after 3 of {COUNT} views" in caplog.text
    monkeypatch.undo()
    assert len(list(tmp_path.iterdir())) == 1
    _make(tmp_path / "d", "--count", str(COUNT), "--workers", "1")
    assert _contents(tmp_path / "d") == _contents(folder)
    assert list(tmp_path.iterdir()) == [tmp_path / "d"]


def test_more_bodies_than_a_mask_tells_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("insonify.results.dataset.coco.MOST_LABELS", 3)
    with pytest.raises(ConfigError, match="has 5 bodies, and a mask tells 3 apart"):
        write_dataset(dataset_config("structures", []), Path("nowhere"))


def test_a_worker_that_is_killed_loses_nothing_else(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "insonify", "dataset", "structures", *SMALL]
    command += ["--out", str(tmp_path / "d"), "--count", "500", "--workers", "2"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        limit = time.monotonic() + 60.0
        while len(list(tmp_path.glob(".d-*/new/done/00000?.json"))) < 2:
            assert process.poll() is None and time.monotonic() < limit
            time.sleep(0.01)
        psutil.Process(process.pid).children()[-1].kill()
        assert process.stderr is not None
        told = process.stderr.read()
    assert process.returncode == 2
    assert "fewer --workers" in told and "of 500 views" in told and "Traceback" not in told
    (left,) = tmp_path.iterdir()
    assert len(list((left / "new/done").iterdir())) >= 2


def test_ctrl_c_keeps_what_is_whole(folder: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "insonify", "dataset", "structures", *SMALL]
    command += ["--out", str(tmp_path / "d"), "--count", "500", "--workers", "2"]
    with subprocess.Popen(
        command, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        limit = time.monotonic() + 60.0
        while len(list(tmp_path.glob(".d-*/new/done/00000?.json"))) < 2:
            assert process.poll() is None and time.monotonic() < limit
            time.sleep(0.01)
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does, to the workers too
        assert process.stderr is not None
        told = process.stderr.read()
    assert process.returncode == 130
    found = re.search(r"stopped after (\d+) of 500 views; the same command goes on", told)
    assert found and "Traceback" not in told
    (left,) = tmp_path.iterdir()
    assert len(list((left / "new/done").iterdir())) == int(found[1]) >= 2


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere.world"], "nowhere.world: there is no such world"),
        (["tank", "--sonar", "asdic"], "asdic"),
        (["tank", "--set", 'poses.look_at=["whale"]'], "no body 'whale'"),
        (["tank", "--set", "poses.clearance_m=50"], "too near to something"),
        ([], "name a world"),
    ],
)
def test_bad_input_is_one_sentence(tmp_path: Path, arguments: list[str], words: str) -> None:
    done = CliRunner().invoke(app, ["dataset", *arguments, "--out", str(tmp_path / "d")])
    assert isinstance(done.exception, InsonifyError)
    assert words in str(done.exception)
    assert list(tmp_path.iterdir()) == []


def test_its_config_makes_it_again(folder: Path, tmp_path: Path) -> None:
    command = ["dataset", "--config", str(folder / "config.toml"), "--out", str(tmp_path / "d")]
    done = CliRunner().invoke(app, [*command, "--workers", "1"], catch_exceptions=False)
    assert done.exit_code == 0
    assert _contents(tmp_path / "d") == _contents(folder)


def test_materials_stand_in_the_config(tmp_path: Path) -> None:
    (tmp_path / "m.toml").write_text("[steel]\nreflectance = 0.9\n")
    arguments = ["--count", "1", "--workers", "1", "--materials", str(tmp_path / "m.toml")]
    _make(tmp_path / "d", *arguments)
    text = (tmp_path / "d/config.toml").read_text()
    assert text.endswith("# [steel]\n# reflectance = 0.9\n")
    assert f'materials = "{tmp_path / "m.toml"}"' in text
    command = ["dataset", "--config", str(tmp_path / "d/config.toml"), "--out", str(tmp_path / "e")]
    assert CliRunner().invoke(app, command, catch_exceptions=False).exit_code == 0


def test_the_loader_in_the_docs(folder: Path) -> None:
    """Run as it stands there, without torch, which needs but these two methods."""
    page = Path(__file__).parents[2] / "docs" / "datasets.md"
    blocks = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    (loader,) = [block for block in blocks if "__getitem__" in block]
    space: dict[str, Any] = {}
    exec(loader, space)
    data = space["SonarViews"](folder)
    image, label = data[4]
    store = xarray.open_zarr(folder / "dataset.zarr")
    assert len(data) == COUNT
    assert image.shape == (1, 32, 16) and image.dtype == np.float32
    np.testing.assert_array_equal(image[0], store.image[4])
    np.testing.assert_array_equal(label, store.label[4].values + 1)
    assert label.dtype == np.int64


def test_the_views_as_a_recording(tmp_path: Path) -> None:
    """The same images and poses by MCAP as in the store."""
    _make(tmp_path / "d", "--count", "3", "--workers", "1", "--mcap")
    store = xarray.open_zarr(tmp_path / "d/dataset.zarr")
    views = list(open_recording(tmp_path / "d/pings.mcap"))
    assert len(views) == 3
    for number, view in enumerate(views):
        np.testing.assert_array_equal(view.ping.image, store.image[number])
        assert view.pose is not None and view.pose.x_m == float(store.x_m[number])
