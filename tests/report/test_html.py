"""The report in a real browser: no console errors, nothing fetched, the 3D scene drawn."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from insonify.config.toml import config_to_toml
from insonify.mission.run import execute
from insonify.mission.setup import scenario_config
from insonify.report.fans import fan_pixels
from insonify.report.html import write_report
from insonify.report.pictures import voxel_shell
from insonify.types import FanGeometry, Ping

pytestmark = pytest.mark.slow

SMALL = {"mapping": {"voxel_m": 0.25}, "survey": {"waypoints": 12}}


@pytest.fixture(scope="module", params=["entropy", "lawnmower"])
def report(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    run = execute(scenario_config("tetrapod", [SMALL, {"planner": request.param}]))
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_report(run.account(), path)
    return path


def test_report_is_self_contained_and_shows_everything(report: Path) -> None:
    page = report.read_text(encoding="utf-8")
    body = page[: page.index("<script>")]
    assert not re.search(r"""(src|href)=["'](?!data:)""", body)
    assert "@import" not in body and "url(" not in body
    for section in ("trajectory", "pings", "map", "metrics", "config"):
        assert f'<section id="{section}">' in body
    assert ('<section id="decisions">' in body) == ("entropy planner" in body)
    text = config_to_toml(scenario_config("tetrapod", [SMALL]), "scan")
    assert text.splitlines()[0] in body


def test_report_opens_in_chromium_without_an_error(report: Path, browser: Any) -> None:
    from selenium.webdriver.common.by import By
    from selenium.webdriver.support.ui import WebDriverWait

    browser.get(report.as_uri())
    WebDriverWait(browser, 60).until(
        lambda b: b.find_elements(By.CSS_SELECTOR, "#scene .gl-container canvas")
    )
    logs = browser.get_log("browser")
    assert [entry for entry in logs if entry["level"] == "SEVERE"] == []
    blank = browser.execute_script(
        "return [...document.images].filter(i => !i.complete || i.naturalWidth < 50).length"
    )
    assert blank == 0
    fetched = browser.execute_script(
        "return performance.getEntriesByType('resource').filter("
        "e => !e.name.startsWith('data:') && !e.name.startsWith('blob:')).map(e => e.name)"
    )
    assert fetched == []
    scene = browser.find_element(By.ID, "scene")
    browser.execute_script("arguments[0].scrollIntoView()", scene)
    shot = report.with_name("scene.png")
    assert scene.screenshot(str(shot))
    colours = np.asarray(Image.open(shot).convert("RGB")).reshape(-1, 3)
    assert len(np.unique(colours // 32, axis=0)) > 8, "the 3D scene is blank"


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
    import trimesh

    filled = rng.random((5, 6, 7)) < 0.5
    vertices, faces = voxel_shell(filled, np.array([1.0, 2.0, 3.0]), 0.5)
    mesh = trimesh.Trimesh(vertices, faces)
    assert abs(mesh.volume) == pytest.approx(filled.sum() * 0.125)
    low = np.argwhere(filled).min(axis=0) * 0.5 + [1.0, 2.0, 3.0]
    np.testing.assert_allclose(mesh.bounds[0], low)
