from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.chromium import DESKTOP, PHONE, errors, fetched, resize, scrolls_sideways

from insonify.io.recordings import open_recording
from insonify.io.recordings.arrays import save_arrays
from insonify.mapping.mapper import MappingSettings
from insonify.mission.remap import map_recordings
from insonify.report.map_html import write_map_report
from insonify.types import FanGeometry, Ping, Pose, PosedPing

pytestmark = pytest.mark.slow

FAN = FanGeometry(np.radians(60.0), np.radians(14.0), 32, 80, 0.5, 8.0)


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("map")
    image = np.zeros((80, 32), np.float32)
    image[60:64] = 0.9
    pings = [
        PosedPing(Ping(image, FAN, time_s=float(k)), Pose(0.3 * k, 0.1 * k, -5.0)) for k in range(8)
    ]
    save_arrays(folder / "dive.npz", pings)
    remap = map_recordings([open_recording(folder / "dive.npz")], MappingSettings(voxel_m=0.2))
    write_map_report(remap, folder / "report.html")
    return folder / "report.html"


def test_it_tells_sonar_region_and_recordings(report: Path) -> None:
    page = report.read_text(encoding="utf-8")
    assert not re.search(r"""(src|href|srcset)=["'](?!data:)""", page)
    assert "60° across, 14° high, 32 beams of 80 bins, 0.5 to 8 m" in page
    assert "dive.npz, ping " in page and "<b>8</b>pings mapped" in page


@pytest.mark.parametrize("size", [DESKTOP, PHONE])
def test_it_opens_in_chromium_without_an_error(
    report: Path, browser: Any, size: tuple[int, int]
) -> None:
    resize(browser, size)
    browser.get(report.as_uri())
    assert errors(browser) == [] and fetched(browser) == []
    assert not scrolls_sideways(browser, size[0])
    widths = browser.execute_script("return [...document.images].map(i => i.naturalWidth)")
    assert len(widths) >= 12 and min(widths) > 200
