"""Datasets of several worlds, and what other programs read of them."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tarfile
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio.features
import webdataset
import xarray
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from PIL import Image
from ruamel.yaml import YAML
from typer.testing import CliRunner

from insonify.cli import app
from insonify.errors import ConfigError, InsonifyError
from insonify.imaging.dataset import PARTS, Dataset, dataset_config
from insonify.results.dataset import shards
from insonify.results.dataset.coco import categories_of, category_pixels, masks_of
from insonify.results.dataset.licences import licence_of
from insonify.results.dataset.yolo import polygon
from insonify.results.files import load_result
from insonify.scene.named import named_scene
from insonify.sonar.truth import Truth
from insonify.types import Array

pytestmark = pytest.mark.slow

WORLDS = ["structures", "tank", "arch@3"]
SMALL = ["--set", "sonar.beams=24", "--set", "sonar.bins=40", "--set", "sonar.range_max_m=20"]
COUNT = 7


def _make(folder: Path, *more: str, worlds: list[str] = WORLDS) -> dict[str, Any]:
    command = ["dataset", *worlds, *SMALL, "--out", str(folder), "--json", *more]
    done = CliRunner().invoke(app, command, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return dict(json.loads(done.stdout))


MORE = ["--count", str(COUNT), "--split", "1/1/1", "--format", "yolo", "--format", "webdataset"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("dataset") / "d"
    _make(path, *MORE, "--license", "CC-BY-4.0", "--workers", "1")
    return path


def _contents(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def _filled(ring: Array, height: int, width: int) -> Array:
    """The pixels whose centres lie in a ring, by GDAL."""
    shape = {"type": "Polygon", "coordinates": [[*map(tuple, ring), tuple(ring[0])]]}
    return np.asarray(rasterio.features.rasterize([(shape, 1)], (height, width)), bool)


def _yolo(folder: Path, number: int, height: int, width: int) -> dict[int, Array]:
    """The masks of a view's labels by class."""
    found: dict[int, Array] = {}
    for line in (folder / f"labels/{number:06d}.txt").read_text().splitlines():
        kind, *numbers = line.split()
        corners = np.array(numbers, float).reshape(-1, 2)
        assert len(corners) >= 4 and corners.min() >= 0.0 and corners.max() <= 1.0
        mask = _filled(corners * (width, height), height, width)
        found[int(kind)] = found.get(int(kind), False) | mask
    return found


def test_yolo_labels_fill_the_masks_again(folder: Path) -> None:
    about = YAML(typ="safe").load((folder / "data.yaml").read_text())
    store = xarray.open_zarr(folder / "dataset.zarr")
    assert list(about["names"].values()) == store.attrs["categories"]
    for number in range(COUNT):
        mask = np.asarray(Image.open(folder / f"masks/{number:06d}.png"))
        found = _yolo(folder, number, *mask.shape)
        assert sorted(found) == [kind - 1 for kind in np.unique(mask) if kind]
        for kind, filled in found.items():
            np.testing.assert_array_equal(filled, mask == kind + 1)


def test_yolo_finds_labels_beside_the_pictures_of_each_part(folder: Path) -> None:
    about = YAML(typ="safe").load((folder / "data.yaml").read_text())
    assert "path" not in about  # so that it is where the file lies
    seen = []
    for part in PARTS:
        for line in (folder / about[part]).read_text().splitlines():
            picture = str(folder / line.removeprefix("./"))
            assert line.startswith("./") and Path(picture).is_file()
            label = "/labels/".join(picture.rsplit("/images/", 1)).rsplit(".", 1)[0] + ".txt"
            assert Path(label).is_file()
            seen.append(picture)
    assert len(seen) == len(set(seen)) == COUNT


@given(
    arrays.arrays(np.bool_, st.tuples(st.integers(1, 9), st.integers(1, 9))).filter(
        lambda mask: bool(mask.any())
    )
)
def test_a_polygon_holds_the_centres_of_its_pixels_and_no_others(mask: Array) -> None:
    ring = polygon(mask)
    assert ring.min() >= 0.0 and (ring.max(axis=0) <= mask.shape[::-1]).all()
    np.testing.assert_array_equal(_filled(ring, *mask.shape), mask)


def test_a_polygon_has_no_corner_on_a_straight_line() -> None:
    mask = np.zeros((9, 12), bool)
    mask[2:7, 3:10] = True
    assert len(polygon(mask)) == 8  # of a rectangle with its corners cut off


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # it closes no file
def test_webdataset_reads_the_shards(folder: Path) -> None:
    store = xarray.open_zarr(folder / "dataset.zarr")
    seen = []
    for part in PARTS:
        shard = folder / f"shards/{part}-000000.tar"
        for sample in webdataset.WebDataset(str(shard), shardshuffle=False).decode("pil"):
            number, told = int(sample["__key__"]), sample["json"]
            picture, mask = np.asarray(sample["png"].convert("L")), sample["mask.png"]
            np.testing.assert_allclose(picture / 255.0, store.image[number], atol=0.5 / 255 + 1e-6)
            name = f"{number:06d}.png"
            assert mask.convert("RGB").tobytes() == Image.open(
                folder / "masks" / name
            ).convert("RGB").tobytes()  # fmt: skip
            assert told["split"] == part == store.parts[int(store.world[number])]
            assert told["pose_m_deg"][0] == float(store.x_m[number])
            assert told["objects"][0]["category"] in told["categories"]
            seen.append(number)
    assert sorted(seen) == list(range(COUNT))


def test_a_shard_holds_so_many_views(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shards, "VIEWS_A_SHARD", 2)
    _make(tmp_path / "d", *MORE[:2], "--format", "webdataset", "--workers", "1", worlds=["tank"])
    names = []
    for number in range(4):
        with tarfile.open(tmp_path / f"d/shards/train-{number:06d}.tar") as shard:
            names.append([member.name for member in shard])
            assert all((one.mtime, one.uid, one.uname) == (0, 0, "") for one in shard.getmembers())
    assert [len(members) for members in names] == [6, 6, 6, 3]
    assert names[3] == ["000006.json", "000006.mask.png", "000006.png"]
    assert len(list((tmp_path / "d/shards").iterdir())) == 4


def test_no_world_is_in_two_parts(folder: Path) -> None:
    store = xarray.open_zarr(folder / "dataset.zarr")
    assert store.attrs["worlds"] == WORLDS and sorted(store.attrs["parts"]) == sorted(PARTS)
    np.testing.assert_array_equal(store.world, np.arange(COUNT) % 3)
    whole = json.loads((folder / "annotations.json").read_text())
    seen: dict[str, set[str]] = {}
    count = 0
    for part in PARTS:
        coco = json.loads((folder / f"annotations-{part}.json").read_text())
        images = [one for one in whole["images"] if one["split"] == part]
        assert coco["images"] == images and coco["categories"] == whole["categories"]
        numbers = {image["id"] for image in images}
        assert {note["image_id"] for note in coco["annotations"]} == numbers
        seen[part] = {image["world"] for image in images}
        assert seen[part] == {WORLDS[number % 3] for number in numbers}
        count += len(images)
    assert count == COUNT
    assert all(not one & other for one, other in pairwise([*seen.values(), seen["train"]]))
    result = load_result(folder).to_json()
    assert {part: set(told["worlds"]) for part, told in result["parts"].items()} == seen


def test_one_list_of_labels_for_all_worlds(folder: Path, tmp_path: Path) -> None:
    """A view of several worlds shows the same as that of its world alone, by other numbers."""
    store = xarray.open_zarr(folder / "dataset.zarr")
    _make(tmp_path / "d", "--count", "2", "--workers", "1", worlds=["structures", "tank"])
    other = xarray.open_zarr(tmp_path / "d/dataset.zarr")
    assert other.attrs["labels"] == store.attrs["labels"][: len(other.attrs["labels"])]
    for number in (0, 1):
        np.testing.assert_array_equal(store.image[number], other.image[number])
        np.testing.assert_array_equal(store.label[number], other.label[number])
    tank = named_scene("tank").labels
    shown = {store.attrs["labels"][k] for k in np.unique(store.label[1]) if k >= 0}
    assert shown and shown <= set(tank)


def test_same_bytes_by_any_number_of_processes(folder: Path, tmp_path: Path) -> None:
    _make(tmp_path / "d", *MORE, "--license", "cc-by-4.0", "--workers", "2")
    one, other = _contents(folder), _contents(tmp_path / "d")
    assert one.pop("config.toml").replace(b"CC-BY", b"cc-by") == other.pop("config.toml")
    assert one == other


def test_the_card_is_what_the_hub_reads(folder: Path) -> None:
    _, front, text = (folder / "README.md").read_text().split("---\n", 2)
    told = YAML(typ="safe").load(front)
    assert told["license"] == "cc-by-4.0" and told["size_categories"] == ["n<1K"]
    (config,) = told["configs"]
    assert [one["split"] for one in config["data_files"]] == ["train", "validation", "test"]
    for one in config["data_files"]:
        assert len(list(folder.glob(one["path"]))) == 1
    result = load_result(folder).to_json()
    for name, one in result["categories"].items():
        assert f"| {name} | {one['views']:,} | {one['pixels']:,} |" in text
    for part, one in result["parts"].items():
        assert f"| {part} | {one['views']} | {', '.join(one['worlds'])} |" in text
    assert "Creative Commons Attribution 4.0" in text and "](statistics.png)" in text
    assert str(folder.parent) not in text
    picture = np.asarray(Image.open(folder / "statistics.png").convert("L"))
    assert picture.shape[1] > 1000 and len(np.unique(picture)) > 50


def test_a_licence_of_one_s_own(tmp_path: Path) -> None:
    (tmp_path / "Lab terms.txt").write_text("Ask us first.\n")
    words = ["--count", "1", "--workers", "1", "--license", str(tmp_path / "Lab terms.txt")]
    _make(tmp_path / "d", *words, worlds=["tank"])
    assert (tmp_path / "d/LICENSE").read_text() == "Ask us first.\n"
    card = (tmp_path / "d/README.md").read_text()
    told = YAML(typ="safe").load(card.split("---\n", 2)[1])
    keys = ("license", "license_name", "license_link")
    assert [told[key] for key in keys] == ["other", "Lab terms", "LICENSE"]
    assert json.loads((tmp_path / "d/annotations.json").read_text())["licenses"][0]["id"] == 1
    _make(tmp_path / "d", *words[:4], "--force", worlds=["tank"])
    assert not (tmp_path / "d/LICENSE").exists()
    assert "license: unknown" in (tmp_path / "d/README.md").read_text()
    assert licence_of("") is None
    (tmp_path / "bad.txt").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match=r"bad\.txt: cannot be read as the text of a licence"):
        licence_of(str(tmp_path / "bad.txt"))


@pytest.mark.parametrize(
    ("modules", "words", "told", "whole"),
    [
        (["matplotlib"], [], "no picture of the statistics is drawn: .*insonify.reports.'", True),
        (["contourpy"], ["--format", "yolo"], "labels for YOLO needs contourpy.*insonify", False),
        (["zarr"], [], "a dataset needs zarr.*'insonify.datasets.'", False),
    ],
)
def test_what_is_not_installed_is_said(
    modules: list[str], words: list[str], told: str, whole: bool, tmp_path: Path
) -> None:
    arguments = ["dataset", "tank", *SMALL, "--count", "1", "--workers", "1", *words, "--out", "d"]
    code = (
        f"import sys\nfor name in {modules!r}: sys.modules[name] = None\n"
        f"sys.argv = ['insonify', *{arguments!r}]\n"
        "from insonify.cli import main\nmain()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == (0 if whole else 2) and re.search(told, done.stderr)
    names = {path.name for path in (tmp_path / "d").iterdir()} if whole else set()
    assert {path.name for path in tmp_path.iterdir()} == ({"d"} if whole else set())
    if whole:
        assert "README.md" in names and "statistics.png" not in names
        assert "statistics.png" not in (tmp_path / "d/README.md").read_text()


def test_a_dataset_that_replaces_another_keeps_none_of_its_labels(tmp_path: Path) -> None:
    words = ["--count", "1", "--workers", "1"]
    _make(tmp_path / "d", *words, "--format", "yolo", worlds=["tank"])
    (tmp_path / "d/notes.txt").write_text("mine")
    _make(tmp_path / "d", *words, "--seed", "1", "--force", worlds=["tank"])
    names = {path.name for path in (tmp_path / "d").iterdir()}
    assert "notes.txt" in names and not names & {"labels", "data.yaml", "train.txt"}


@given(st.integers(1, 40), st.tuples(*[st.integers(0, 9)] * 3), st.integers(0, 5))
def test_every_part_that_is_asked_for_has_a_world(
    worlds: int, shares: tuple[int, int, int], seed: int
) -> None:
    layer = {
        "more_worlds": [f"field@{k}" for k in range(1, worlds)],
        "split": shares,
        "seed": seed,
    }
    try:
        config = dataset_config("field@0", [layer])
    except ConfigError as err:
        assert "split" in str(err)
        return
    parts = config.parts
    assert len(parts) == worlds and parts == Dataset.model_validate(config.model_dump()).parts
    assert set(parts) == {part for part, share in zip(PARTS, shares, strict=True) if share}
    for part, share in zip(PARTS[1:], shares[1:], strict=True):
        exact = worlds * share / sum(shares)
        assert parts.count(part) in {max(1, round(exact)) if share else 0}


@pytest.mark.parametrize(
    ("layer", "words"),
    [
        ({"split": [8, 1, 1]}, "8/1/1 of 2 worlds leaves none to train on"),
        ({"split": [8, 1]}, "three shares"),
        ({"split": [0, 1, 1]}, "three shares"),
        ({"split": [1, 1, 0], "val": ["tank"]}, "name none yourself"),
        ({"val": ["atlantis"]}, "val: 'atlantis' is none of the worlds"),
        ({"val": ["tank"], "test": ["tank"]}, "tank is in both"),
        ({"val": ["tank"], "test": ["structures"]}, "no world to train on"),
        ({"more_worlds": ["structures"]}, "structures: is named twice"),
        ({"formats": ["tfrecord"]}, "formats"),
    ],
)
def test_parts_that_cannot_be(layer: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        dataset_config("structures", [{"more_worlds": ["tank"]}, layer])


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["tank", "--license", "mine"], "license: 'mine' is no text file, nor one of apache-2.0"),
        (["tank", "--split", "most/rest"], "--split takes shares .* not 'most/rest'"),
        (["tank", "field@x"], "field@x: there is no such world"),
        (["structures", "tank", "--set", "poses.look_at=['whale']"], "no body 'whale'"),
    ],
)
def test_bad_input_leaves_nothing(tmp_path: Path, words: list[str], told: str) -> None:
    arguments = ["dataset", *words, "--count", "3", "--out", str(tmp_path / "d")]
    done = CliRunner().invoke(app, arguments)
    assert isinstance(done.exception, InsonifyError)
    assert re.search(told, str(done.exception))
    assert list(tmp_path.iterdir()) == []


def test_worlds_named_by_hand_and_bodies_of_some_of_them() -> None:
    layers = [{"more_worlds": ["fls-tank"], "test": ["fls-tank"]}]
    config = dataset_config("fls-structures", layers)
    assert config.worlds == ("structures", "tank") and config.parts == ("train", "test")
    assert config.sonar.name == dataset_config("fls-structures", []).sonar.name
    same = dataset_config("a/site.world", [{"more_worlds": ["b/site.world"]}])
    assert same.names == ("site", "site-2")


def test_a_scenario_of_another_seed_is_another_world() -> None:
    first, again, other = (named_scene(name) for name in ("field", "field@0", "field@3"))
    places = [
        np.concatenate([vertices.mean(axis=0) for vertices, _ in scene.meshes])
        for scene in (first, again, other)
    ]
    np.testing.assert_array_equal(places[0], places[1])
    assert places[0].shape != places[2].shape or not np.allclose(places[0], places[2])


def test_two_of_a_kind_are_two_masks_of_one_category() -> None:
    labels = ("tower", "seabed", "tower#2", "tower#12")
    label = np.array([[0, 2], [1, -1], [3, 1]], np.int32)
    shadow = np.array([[False, False], [False, True], [False, True]])
    empty = np.zeros(label.shape, np.float32)
    truth = Truth(labels, label, empty, empty, empty, shadow, shadow)
    assert categories_of(labels) == ["tower", "seabed", "shadow"]
    found = [(category, np.flatnonzero(mask).tolist()) for category, mask in masks_of(truth)]
    assert found == [(1, [0]), (2, [2]), (1, [1]), (1, [4]), (3, [3, 5])]
    assert category_pixels(truth).tolist() == [[1, 1], [2, 3], [1, 3]]
