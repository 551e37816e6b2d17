"""The report in a real browser: no console errors, nothing fetched, the 3D scene drawn."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from benchmarks.chromium import DESKTOP, PHONE, errors, fetched, resize, scrolls_sideways
from benchmarks.screenshots import wait_for
from PIL import Image

import insonify
from insonify.config.toml import config_to_toml
from insonify.mission.result import ScanRow
from insonify.mission.run import execute
from insonify.mission.setup import scenario_config
from insonify.report.fans import fan_pixels
from insonify.report.html import write_report
from insonify.report.pictures import voxel_shell
from insonify.report.scene3d import contours
from insonify.report.scores import losses
from insonify.types import FanGeometry, Ping

pytestmark = pytest.mark.slow

SMALL = {"mapping": {"voxel_m": 0.25}, "survey": {"waypoints": 12}}
PLANNERS = ("entropy", "lawnmower")


@pytest.fixture(scope="module")
def reports(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("report")
    for planner in PLANNERS:
        run = execute(scenario_config("tetrapod", [SMALL, {"planner": planner}]))
        write_report(run.account(), folder / f"{planner}.html")
    return {planner: folder / f"{planner}.html" for planner in PLANNERS}


@pytest.fixture
def report(reports: dict[str, Path]) -> Path:
    return reports["entropy"]


@pytest.mark.parametrize("planner", PLANNERS)
def test_report_is_self_contained_and_shows_everything(
    reports: dict[str, Path], planner: str
) -> None:
    page = reports[planner].read_text(encoding="utf-8")
    body = page[: page.index("<script")]
    assert len(page) < 3e6
    assert not re.search(r"""(src|href|srcset)=["'](?!data:)""", body)
    assert "@import" not in body and "url(" not in body
    sections = re.findall('<section id="([a-z]+)">', body)
    decided = ["decisions"] if planner == "entropy" else []
    assert sections == [
        "summary", "metrics", "trajectory", *decided, "map", "pings", "config",
    ]  # fmt: skip
    text = config_to_toml(scenario_config("tetrapod", [SMALL]), "scan")
    assert text.splitlines()[0] in body


@pytest.mark.parametrize("planner", PLANNERS)
def test_what_is_asked_first_is_told_first(reports: dict[str, Path], planner: str) -> None:
    told = reports[planner].read_text(encoding="utf-8")
    told = told[: told.index('<section id="metrics">')]
    for answer in (
        "park-2025: 29° across, 14° high, 96 beams of 513 bins",
        "5 m above the mean seabed",
        f"insonify {insonify.__version__}",
        "voxels of 0.25 m",
    ):
        assert answer in told
    page = reports[planner].read_text(encoding="utf-8")
    if planner == "entropy":
        assert re.search(r"would show [\d.]+ % of the largest cluster", page)
        assert "a scan is flown for more than 30 %" in page
    else:
        assert "All planned scans are flown" in told


@pytest.mark.parametrize("size", [DESKTOP, PHONE])
def test_report_opens_in_chromium_without_an_error(
    report: Path, browser: Any, size: tuple[int, int]
) -> None:
    resize(browser, size)
    browser.get(report.as_uri())
    wait_for(browser, "#scene .gl-container canvas")
    wait_for(browser, "#still[src^=data]")  # what is printed
    assert errors(browser) == [] and fetched(browser) == []
    assert not scrolls_sideways(browser, size[0])
    blank = browser.execute_script(
        "return [...document.images].filter(i => !i.complete || i.naturalWidth < 50).length"
    )
    assert blank == 0
    scene = browser.find_element("css selector", "#scene")
    browser.execute_script("arguments[0].scrollIntoView()", scene)
    shot = report.with_name("scene.png")
    assert scene.screenshot(str(shot))
    colours = np.asarray(Image.open(shot).convert("RGB")).reshape(-1, 3)
    assert len(np.unique(colours // 32, axis=0)) > 8, "the 3D scene is blank"


def test_the_true_shape_is_switched_on_by_its_name(report: Path, browser: Any) -> None:
    from selenium import webdriver
    from selenium.webdriver.support.ui import WebDriverWait

    browser.get(report.as_uri())
    wait_for(browser, "#scene .gl-container canvas")
    shown = "return document.getElementById('scene').data.find(t => t.name == 'true shape').visible"
    assert browser.execute_script(shown) == "legendonly"
    names = browser.find_elements("css selector", "#scene .legend .traces")
    (name,) = [entry for entry in names if entry.text == "true shape"]
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", name)
    webdriver.ActionChains(browser).move_to_element(name).click().perform()
    WebDriverWait(browser, 20).until(lambda b: b.execute_script(shown) is True)


def test_scans_that_made_the_map_worse_are_found() -> None:
    def row(scan: int, f1: float) -> ScanRow:
        scores = {"precision": f1, "recall": f1, "f1": f1}
        metrics = {kind: {"exact": scores} for kind in ("solid", "surface")}
        return ScanRow(
            scan=scan, pings=9 * scan, path_m=5.0 * scan, total_entropy_bits=1.0, metrics=metrics
        )

    history = [row(1, 0.5), row(2, 0.8), row(3, 0.7), row(4, 0.6999), row(5, 0.9), row(6, 0.1)]
    assert [(a.scan, b.scan) for a, b in losses(history)] == [(2, 3), (5, 6)]


def test_contours_of_the_true_shape_lie_on_it() -> None:
    extents = np.array([2.0, 3.0, 4.0])
    mesh = trimesh.creation.box(extents)
    mesh.apply_translation([5.0, -3.0, -10.0])
    lines = np.concatenate(contours(mesh))
    reach = np.abs(lines - [5.0, -3.0, -10.0]) / (extents / 2)
    np.testing.assert_allclose(reach.max(axis=2), 1.0, atol=1e-6)
    length = np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1).sum()
    assert length == pytest.approx(14 * 10.0 + 7 * 14.0 + 7 * 12.0)  # around each cut


def test_fan_view_puts_port_left_and_range_up() -> None:
    geometry = FanGeometry(np.radians(60.0), 0.2, 30, 40, 0.0, 10.0)
    image = np.zeros((40, 30), np.float32)
    image[20:22, :3] = 1.0
    picture, extent = fan_pixels(Ping(image, geometry), width=400)
    rows, columns = np.nonzero(picture == 1.0)
    right = extent[0] + (columns + 0.5) / 400 * (extent[1] - extent[0])
    ahead = extent[2] + (rows + 0.5) / picture.shape[0] * (extent[3] - extent[2])
    assert (right < 0).all()
    ranges, bearings = np.hypot(right, ahead), np.degrees(np.arctan2(-right, ahead))
    assert 4.95 < ranges.min() < ranges.max() < 5.55
    assert 23.9 < bearings.min() < bearings.max() < 30.1
    assert np.isnan(picture[0, 0])


def test_voxel_shell_is_a_closed_surface_of_the_right_volume(rng: np.random.Generator) -> None:
    filled = rng.random((5, 6, 7)) < 0.5
    vertices, faces = voxel_shell(filled, np.array([1.0, 2.0, 3.0]), 0.5)
    mesh = trimesh.Trimesh(vertices, faces)
    assert abs(mesh.volume) == pytest.approx(filled.sum() * 0.125)
    low = np.argwhere(filled).min(axis=0) * 0.5 + [1.0, 2.0, 3.0]
    np.testing.assert_allclose(mesh.bounds[0], low)
