"""What records show of themselves in notebooks, as plots, and as xarray."""

from __future__ import annotations

import io
import math
import re
import subprocess
import sys
from base64 import b64decode
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from PIL import Image

import insonify
from insonify.display import Pictured, Told
from insonify.errors import GeometryError, ResultError
from insonify.mapping.voxels import IN_VIEW, OBSERVED, VoxelMap
from insonify.mission.account import Account
from insonify.mission.run import Run, execute
from insonify.mission.setup import scenario_config
from insonify.mission.tables import SETTING, Campaign
from insonify.results.scan import save_scan
from insonify.types import Array, Box, FanGeometry, Ping, Pose, PosedPing

MakeMap = Callable[..., VoxelMap]
FAN = FanGeometry(1.2, 0.3, 8, 20, 0.5, 10.5)
SMALL = {"mapping": {"voxel_m": 0.3}, "survey": {"waypoints": 6}, "planner": "lawnmower"}


@pytest.fixture(autouse=True)
def no_window() -> Iterator[None]:
    mpl.use("agg")
    from matplotlib import pyplot  # noqa: TID251

    yield
    pyplot.close("all")


def _spot(beam: int, cell: int) -> Ping:
    image = np.zeros((20, 8), np.float32)
    image[cell, beam] = 1.0
    return Ping(image, FAN, 3.5)


def _values(axes: Axes) -> Array:
    """What is drawn into axes, 0 where nothing is."""
    (shown,) = axes.images
    values: Array = np.nan_to_num(np.ma.getdata(shown.get_array()))  # type: ignore[arg-type]
    return values


def _line(line: Line2D) -> tuple[Array, Array]:
    x, y = line.get_data()
    return np.asarray(x, float), np.asarray(y, float)


def _opened(data: bytes | None) -> Image.Image:
    assert data is not None
    return Image.open(io.BytesIO(data))


def test_a_plotted_ping_has_each_pixel_where_its_echo_is() -> None:
    """Port is left, ahead is up: by the beam's azimuth and the bin's range."""
    for beam, cell in ((0, 10), (7, 10), (3, 19)):
        axes = _spot(beam, cell).plot()
        (shown,) = axes.images
        picture = _values(axes)
        left, right, near, far = shown.get_extent()
        rows, columns = np.nonzero(picture > 0.5)
        x = left + (columns.mean() + 0.5) * (right - left) / picture.shape[1]
        y = near + (rows.mean() + 0.5) * (far - near) / picture.shape[0]
        azimuth, range_m = FAN.beam_azimuths_rad[beam], FAN.bin_ranges_m[cell]
        assert np.arctan2(-x, y) == pytest.approx(azimuth, abs=0.01)
        assert np.hypot(x, y) == pytest.approx(range_m, abs=0.05)


def test_a_ping_is_a_picture_in_a_notebook_always_the_same() -> None:
    ping = _spot(2, 5)
    picture = _opened(ping._repr_png_())
    assert min(picture.size) > 200
    assert ping._repr_png_() == _spot(2, 5)._repr_png_()
    posed = PosedPing(ping, Pose(1.0, 2.0, -3.0, yaw_rad=0.5))
    assert "at (1.00, 2.00, -3.00) m, yaw 29°" in posed.plot().get_title()
    assert PosedPing(ping).plot().get_title() == "3.5 s"
    ahead = PosedPing(Ping(ping.image, FAN, 1371196800.0), Pose(0.0, 0.0, 0.0, yaw_rad=-1e-9))
    assert ahead.plot().get_title().startswith("2013-06-14 08:00:00 UTC, at ")
    assert ahead.plot().get_title().endswith("yaw 0°")


def test_a_single_narrow_beam_is_no_huge_picture() -> None:
    """Of a scanning head, which has one of a degree or so."""
    fan = FanGeometry(0.02, 0.4, 1, 50, 0.0, 75.0)
    ping = Ping(np.linspace(0.0, 1.0, 50, dtype=np.float32)[:, None], fan)
    (shown,) = ping.plot().images
    assert max(_values(ping.plot()).shape) <= 1601
    assert tuple(shown.get_extent())[2:] == (0.0, 75.0)
    assert max(_opened(ping._repr_png_()).size) < 2000


def test_a_turn_of_a_head_is_drawn_all_round() -> None:
    ping = Ping(np.ones((20, 36), np.float32), FanGeometry(math.tau, 0.4, 36, 20, 0.0, 10.0))
    (shown,) = ping.plot().images
    assert tuple(shown.get_extent()) == (-10.0, 10.0, -10.0, 10.0)


def test_it_draws_into_axes_that_are_given() -> None:
    figure = Figure()
    one, other = figure.subplots(1, 2)
    assert _spot(1, 1).plot(one, power=1.0) is one
    assert not other.images and len(one.images) == 1
    assert {text.get_color() for text in one.texts} == {"#1d2733"}  # dark on a white page


def test_a_ping_as_xarray() -> None:
    array = PosedPing(_spot(2, 5), Pose(1.0, 2.0, -3.0, yaw_rad=0.5)).to_xarray()
    brightest = array.isel(array.argmax(("bin", "beam")))
    assert float(brightest.azimuth_rad) == FAN.beam_azimuths_rad[2]
    assert float(brightest.bin_range_m) == FAN.bin_ranges_m[5]
    assert (float(array.x_m), float(array.yaw_rad), array.attrs["time_s"]) == (1.0, 0.5, 3.5)
    assert "x_m" not in PosedPing(_spot(2, 5)).to_xarray().coords


@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), (8.0e5, 16.0, -8.0)])
def test_a_map_as_xarray_has_every_voxel_at_its_place(
    make_map: MakeMap, origin: tuple[float, float, float]
) -> None:
    voxels = make_map(3, blocks=4, reach=2)
    voxels.origin_m = origin
    dense = voxels.to_xarray()
    names = ("probability", "log_odds", "in_view", "observed", "surface")
    assert tuple(dense) == names and dense.sizes == dict(
        zip("xyz", dense.log_odds.shape, strict=True)
    )
    found = dense.log_odds.to_series()
    occupied = found[found > 0.0]
    wanted = voxels.occupied_m() + origin
    index = np.lexsort(wanted.T[::-1])
    np.testing.assert_allclose(list(occupied.index), wanted[index], atol=1e-6)
    assert dense.observed.dtype == bool
    np.testing.assert_allclose(dense.probability, 1 / (1 + np.exp(-dense.log_odds)), rtol=1e-5)
    box = Box((0.0, 0.0, 0.0), (0.4, 0.3, 0.2))
    assert voxels.to_xarray(box).log_odds.shape == (4, 3, 2)
    with pytest.raises(insonify.InsonifyError, match="give a smaller box"):
        voxels.to_xarray(Box((0.0,) * 3, (1e5,) * 3))


def test_a_plotted_map_shows_the_voxel_nearest_to_the_eye() -> None:
    voxels = VoxelMap(0.5)
    voxels.allocate(np.zeros((1, 3), np.int32))
    voxels.seen[:] = IN_VIEW | OBSERVED
    for x, y, z in ((1, 2, 3), (1, 2, 6), (4, 2, 0)):
        voxels.log_odds[0, (x * 8 + y) * 8 + z] = 2.0
    for side, values in (("above", {0.25, 3.25}), ("south", {1.25}), ("east", {0.75, 2.25})):
        assert set(_values(voxels.plot(side=side)).ravel()) - {0.0} == values
    assert tuple(voxels.plot().images[0].get_extent()) == (0.5, 2.5, 1.0, 1.5)
    with pytest.raises(GeometryError, match=r"'west'.*above, south, east"):
        voxels.plot(side="west")
    empty = VoxelMap(0.5).plot()
    assert not empty.images and "no voxel" in empty.texts[0].get_text()
    page = VoxelMap(0.5)._repr_html_()
    assert page is not None and "0 voxels" in page


@pytest.fixture(scope="module")
def run() -> Run:
    return execute(scenario_config("tetrapod", [SMALL]))


@pytest.mark.slow
def test_a_run_shows_the_same_as_what_is_loaded_of_it(run: Run, tmp_path: Path) -> None:
    save_scan(run, tmp_path)
    loaded = insonify.load_run(tmp_path)
    assert isinstance(loaded, Account)
    page = loaded._repr_html_()
    assert page is not None and page == run._repr_html_()
    result = run.result()
    for told in (f"{result.pings} pings", f"{result.path_m:.1f} m", result.stop_reason.sentence,
                 f"{result.metrics['solid']['exact']['f1']:.3f}"):  # fmt: skip
        assert told in page
    (data,) = re.findall(r"base64,([\w+/=]+)", page)
    assert min(_opened(b64decode(data)).size) > 200
    axes = run.plot()
    tracks = [line for line in axes.lines if str(line.get_label()).startswith("scan ")]
    assert len(tracks) == result.scans
    waypoints = np.array([pose.position_m[:2] for pose in run.paths[0].waypoints])
    np.testing.assert_allclose(np.transpose(_line(tracks[0])), waypoints)


@pytest.mark.slow
def test_names_cannot_bring_markup(run: Run) -> None:
    account = run.account()
    evil = account.result.model_copy(update={"scenario": "<script>$x$"})
    page = replace(account, result=evil)._repr_html_()
    assert page is not None and "<script>" not in page and "&lt;script&gt;$x$" in page


def _campaign(scenarios: tuple[str, ...]) -> Campaign:
    rows = [
        {"run": f"{scenario}-{planner}-{seed}", "scenario": scenario, "mapper": "bayes",
         "planner": planner, "sonar": "s", "model": "cerqueira", "navigation": "none",
         "seed": seed, "scan": scan, "scans": scan, "pings": 10 * scan, "path_m": 5.0 * scan,
         "time_s": None, "total_entropy_bits": 1.0, "solid_exact_f1": 0.2 * scan + 0.01 * seed}
        for scenario in scenarios
        for planner in ("entropy", "uniform")
        for seed in (0, 1)
        for scan in (1, 2)
    ]  # fmt: skip
    curves = pd.DataFrame(rows)
    runs = curves[curves["scan"] == 2].reset_index(drop=True)
    return Campaign("many", runs, curves, pd.DataFrame(), ())


def test_a_campaign_shows_its_means_and_one_setting_s_curves() -> None:
    page = _campaign(("a", "b"))._repr_html_()
    assert page is not None and page.count("<img") == 2 and "0.405 ± " in page
    axes = _campaign(("a",)).plot(along="pings")
    means = {line.get_label(): _line(line) for line in axes.lines}
    x, y = means["bayes, entropy"]
    assert np.interp(20.0, x, y) == pytest.approx(0.405)
    both = _campaign(("a", "b"))
    assert both.plot(scenario="b").get_ylabel() == "solid exact f1"
    for options, words in (
        ({}, "2 settings do not compare.*scenario='a'"),
        ({"scenario": "c"}, "scenario='c'.*a, b"),
        ({"colour": "c"}, ", ".join(SETTING)),
        ({"score": "luck"}, "no column 'luck'"),
    ):
        with pytest.raises(ResultError, match=words):
            both.plot(None, **options)
    empty = Campaign("none", pd.DataFrame(), pd.DataFrame(), pd.DataFrame(), ())
    assert "<img" not in str(empty._repr_html_())


def test_without_the_libraries_text_is_shown_and_the_sentence_says_how() -> None:
    code = (
        "import sys\n"
        "for name in ('matplotlib', 'xarray'): sys.modules[name] = None\n"
        "import numpy as np\n"
        "from insonify.errors import MissingExtraError\n"
        "from insonify.mapping.voxels import VoxelMap\n"
        "from insonify.types import FanGeometry, Ping\n"
        "ping = Ping(np.zeros((4, 2), np.float32), FanGeometry(1, 1, 2, 4, 0, 1))\n"
        "assert ping._repr_png_() is None and VoxelMap(1.0)._repr_html_() is None\n"
        "for call in (ping.plot, ping.to_xarray, VoxelMap(1.0).to_xarray):\n"
        "    try: call()\n"
        "    except MissingExtraError as err: print(err)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    plot, array, dense = done.stdout.splitlines()
    assert "matplotlib" in plot and "pip install 'insonify[reports]'" in plot
    assert array == dense and "pip install 'insonify[datasets]'" in array


def test_each_kind_shows_itself_in_one_way() -> None:
    assert all(issubclass(kind, Told) for kind in (VoxelMap, Account, Run, Campaign))
    assert all(issubclass(kind, Pictured) for kind in (Ping, PosedPing))


def test_the_former_name_says_the_new_one() -> None:
    with pytest.warns(DeprecationWarning, match="load_scan is called load_run"):
        assert insonify.load_scan is insonify.load_run
