"""The pictures in the README and docs: ``python -m benchmarks.pictures [--presets]``.

``--presets`` makes only the sheet of all sonars at a real wreck's site.
"""

from __future__ import annotations

import argparse
import dataclasses
import io
import math
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from benchmarks.chromium import chromium, missing
from benchmarks.realism import RECORDINGS, TWINS, twin
from insonify.imaging.dataset import Shots, dataset_config
from insonify.imaging.route import Line, Profile, Shot, Turn, simulate, simulation_config
from insonify.io.recordings import open_recording
from insonify.mission.run import execute
from insonify.mission.setup import scenario_config
from insonify.report.fans import INK, WATER, draw_fan, draw_waterfall, fan_pixels, png, scale_of
from insonify.report.html import write_report
from insonify.report.pictures import draw_candidates, draw_slices, draw_undecided
from insonify.results.dataset import coco
from insonify.scene import Scene
from insonify.scene.experiments import bumpy_sphere, structures
from insonify.scene.materials import Material
from insonify.scene.named import named_scene
from insonify.sonar import Sonar
from insonify.sonar.camera import Camera
from insonify.sonar.devices import Kind, SonarDevice, named_device, sonar_presets
from insonify.sonar.formation import ImageSettings
from insonify.sonar.physical import PhysicalSettings
from insonify.sonar.scanning import sidescan_line, waterfall
from insonify.types import Float64, Ping, Pose
from insonify.view.page import Page
from insonify.view.story import Story

FOLDER = Path("docs/images")
_ARROW_LEFT = "\ue012"
"""What WebDriver calls the key."""
WORLDS = Path("../shared/data/worlds")


def scan() -> None:
    """The wreck's first decision, a ping and the map."""
    run = execute(scenario_config("wreck"))
    account = run.account()
    _, posed = account.keyframes[3]
    first = account.decisions[1]
    decision = [draw_undecided(account, first), draw_candidates(first)]
    _beside(decision).save(FOLDER / "wreck-decision.png", optimize=True)
    (FOLDER / "wreck-ping.png").write_bytes(draw_fan(posed.ping, "wreck, scan 2"))
    _beside([image for _, image in draw_slices(account)]).save(
        FOLDER / "wreck-map.png", optimize=True
    )


def _beside(pictures: list[bytes]) -> Image.Image:
    """Pictures in a row, on white."""
    tiles = [Image.open(io.BytesIO(picture)).convert("RGB") for picture in pictures]
    height = max(tile.height for tile in tiles)
    row = Image.new("RGB", (sum(tile.width for tile in tiles), height), "white")
    for k, tile in enumerate(tiles):
        row.paste(tile, (sum(before.width for before in tiles[:k]), (height - tile.height) // 2))
    return row


def pages() -> None:
    """The report and the view of a scan of the wreck, in a browser."""
    story = Story("wreck, entropy planner, seed 0")
    run = execute(scenario_config("wreck"), watch=story.watch)
    with tempfile.TemporaryDirectory() as folder, chromium(1500, 950) as browser:
        report = Path(folder) / "report.html"
        write_report(run.account(), report)
        browser.get(report.as_uri())
        _when(browser, "#scene .gl-container canvas")
        _photograph(browser, "report.png")
        page = Page(story)
        browser.get(page.url)
        _when(browser, "[data-image='ping']")
        back = run.pings - run.config.survey.waypoints * 3 // 2
        slider = browser.find_element("css selector", "[role=slider]")
        slider.send_keys(*[_ARROW_LEFT] * (run.pings - back))
        for label in ("true object", "true seabed"):
            box = f"//*[normalize-space(text())='{label}']/following::input[@type='checkbox'][1]"
            browser.execute_script("arguments[0].click()", browser.find_element("xpath", box))
        browser.execute_script(
            "document.querySelectorAll('[class*=Notification-closeButton]').forEach(b=>b.click())"
        )
        _photograph(browser, "view.png")
        page.close()


def views() -> None:
    """Shots of a dataset of the real wreck's site, each beside its mask."""
    world = str(WORLDS / "sunken_ship_site.world")
    config = dataset_config(world, [{"sonar": {"preset": "gemini-720i", "range_max_m": 50.0}}])
    made = Shots(config, named_scene(world))
    tiles = []
    for number in range(8):
        shot = made.shot(number)
        assert shot.truth is not None
        for png_bytes in (coco.image_png(shot.posed.ping), coco.mask_png(shot.truth)):
            tile = Image.open(io.BytesIO(png_bytes)).convert("RGB")
            tiles.append(np.asarray(tile.resize((190, 380))))
    rows = [np.concatenate(tiles[k : k + 8], axis=1) for k in (0, 8)]
    Image.fromarray(np.concatenate(rows)).quantize(128).save(FOLDER / "dataset.png", optimize=True)


def presets() -> None:
    """Every preset at the real wreck's site, by the sonar equation, at its own range or 60 m."""
    scene = named_scene(str(WORLDS / "sunken_ship_site.world"), [WORLDS.parent / "models"])
    sheet = [_tile(name, scene) for name in sonar_presets()]
    width, height, across = *sheet[0].size, 5
    whole = Image.new("RGB", (across * width, math.ceil(len(sheet) / across) * height), WATER)
    for k, tile in enumerate(sheet):
        whole.paste(tile, (k % across * width, k // across * height))
    whole.quantize(128).save(FOLDER / "presets.png", optimize=True)


def _tile(name: str, scene: Scene) -> Image.Image:
    """What a preset sees of the wreck, as its pictures show it."""
    device = named_device(name)
    reach_m = min(device.range_max_m, 60.0)
    away_m = 0.0 if device.kind is Kind.PROFILING else 7.0 + 0.3 * reach_m
    up_m = max(0.15 * reach_m, 10.0 if device.kind is Kind.PROFILING else 1.0)
    below = scene.cast(np.array([-away_m, 0.0, -30.0]), np.array([[0, 0, -1]], np.float32))
    at = [0.0, -away_m, 0.0, -30.0 - float(below.range_m[0]) + up_m, 0.0, 0.0, 0.0]
    if device.kind is Kind.FORWARD_LOOKING:
        at[5] = math.degrees(math.atan2(up_m, 0.5 * reach_m)) - device.tilt_deg
    route = [at]
    if device.kind is Kind.SIDESCAN:
        route = [[k, -20.0 + 0.5 * k, -15.0, -52.0, 0.0, 0.0, 0.0] for k in range(80)]
    sonar = {"preset": name, "range_max_m": reach_m}
    config = simulation_config(
        str(WORLDS / "sunken_ship_site.world"),
        [{"model": "physical", "sonar": sonar, "route": route, "timed": False}],
    )
    scale, lines = scale_of("physical", device.display_gamma), []
    for record in simulate(config, scene):
        if isinstance(record, Line):
            lines.append(sidescan_line(record.port.ping.image, record.starboard.ping.image))
        elif isinstance(record, Turn):
            drawn = draw_fan(record.deskewed, name, 4.2, scale, smooth=True)
        else:
            shot = record.shot if isinstance(record, Profile) else record
            drawn = draw_fan(shot.posed.ping, name, 4.2, scale)
    if lines:
        along_m = 0.5 * np.arange(len(lines), dtype=np.float64)
        drawn = draw_waterfall(waterfall(lines), device.geometry.bin_m, along_m, name, scale)
    tile = Image.open(io.BytesIO(drawn)).convert("RGB")
    tile.thumbnail((420, 330))
    framed = Image.new("RGB", (430, 340), WATER)
    framed.paste(tile, ((430 - tile.width) // 2, (340 - tile.height) // 2))
    return framed


def _when(browser: Any, selector: str) -> None:
    """Wait until a page shows something."""
    limit = time.monotonic() + 60.0
    while not browser.find_elements("css selector", selector):
        if time.monotonic() > limit:
            raise TimeoutError(f"{browser.current_url} shows no {selector}")
        time.sleep(0.2)


def _photograph(browser: Any, name: str) -> None:
    time.sleep(5.0)  # software draws slowly
    picture = Image.open(io.BytesIO(browser.get_screenshot_as_png())).convert("RGB")
    picture.quantize(256).save(FOLDER / name, optimize=True)


def experiments() -> None:
    """The paper's figures 7 and 8: each world by camera and by sonar."""
    camera = Camera()
    for kind, names in (
        ("fls", ("fls-tank", "fls-grid", "fls-structures")),
        ("msis", ("msis-tank", "msis-turning", "msis-structures")),
    ):
        figure = Figure(figsize=(10.5, 9.0), layout="constrained")
        panels = figure.subplots(3, 2 if kind == "fls" else 3)
        for row, name in zip(panels, names, strict=True):
            config = simulation_config(name, [])
            scene = named_scene(config.world)
            (record,) = simulate(config, scene)
            assert isinstance(record, Shot | Turn)
            posed = record.posed if isinstance(record, Shot) else record.pings[0]
            pose = posed.pose
            assert pose is not None
            tilt = math.radians(config.sonar.tilt_deg)
            tilted = dataclasses.replace(pose, pitch_rad=pose.pitch_rad + tilt)
            row[0].imshow(camera.take(scene, tilted))
            row[0].set_axis_off()
            row[0].set_title(name, fontsize=9, color=INK)
            if isinstance(record, Shot):
                _show(row[1], record.posed.ping, "")
            else:
                _show(row[1], record.polar, "as it comes")
                _show(row[2], record.deskewed, "de-skewed")
        (FOLDER / f"{kind}-experiments.png").write_bytes(png(figure))


def sphere() -> None:
    """Figures 5 and 6: a sphere smooth and with a normal map; three reflectances."""
    device = SonarDevice(
        azimuth_fov_deg=40, elevation_fov_deg=30, beams=256, bins=500, range_min_m=2.0,
        range_max_m=4.5, tilt_deg=0,
    )  # fmt: skip
    sonar = Sonar(device, image=ImageSettings(speckle=0.1, noise=0.01))
    pose = Pose(-3.4, 0.0, 1.2, pitch_rad=math.radians(20))
    shown = [
        ("smooth", bumpy_sphere(bumpy=False)),
        ("normal map", bumpy_sphere()),
        *((f"R = {r:.2f}", bumpy_sphere(material=Material("m", r))) for r in (0.35, 1.40, 2.12)),
    ]
    figure = Figure(figsize=(13.0, 5.4), layout="constrained")
    panels = figure.subplots(2, len(shown))
    camera = Camera()
    for (title, scene), (above, below) in zip(shown, panels.T, strict=True):
        above.imshow(camera.take(scene, dataclasses.replace(pose, x_m=-2.4, z_m=0.85)))
        above.set_axis_off()
        above.set_title(title, fontsize=9, color=INK)
        _show(below, sonar.ping(scene, pose), "")
    (FOLDER / "sphere.png").write_bytes(png(figure))


def real() -> None:
    """Frames of an ARIS and an Oculus beside simulated ones of the same fans, with histograms."""
    figure = Figure(figsize=(12.5, 8.0), layout="constrained")
    panels = figure.subplots(2, 4, width_ratios=(1, 1, 1, 1.2))
    for row, (name, file, preset, known) in zip(panels, TWINS, strict=True):
        recorded = next(iter(open_recording(RECORDINGS / file))).ping
        device = twin(preset, recorded.geometry, **known)
        far = recorded.geometry.range_max_m
        pose = Pose(9.0 - 0.55 * far, 0.0, -20.0 + 0.12 * far, pitch_rad=math.radians(8))
        scene = structures()
        images = [
            (f"{name}, recorded", recorded),
            ("simulated, cerqueira", Sonar(device).ping(scene, pose)),
            ("simulated, physical", Sonar(device, physical=PhysicalSettings()).ping(scene, pose)),
        ]
        for axes, (title, ping) in zip(row[:3], images, strict=True):
            _show(axes, ping, title)
        for title, ping in images:
            counts, edges = np.histogram(ping.image, 64, (0, 1), density=True)
            middles: Float64 = (edges[1:] + edges[:-1]) / 2
            row[3].semilogy(middles, np.maximum(counts, 1e-3), label=title)
        row[3].set(xlabel="intensity", ylabel="density of pixels", ylim=(5e-3, 100))
        row[3].legend(fontsize=7)
    (FOLDER / "real-and-simulated.png").write_bytes(png(figure))


def _show(axes: Axes, ping: Ping, title: str) -> None:
    picture, extent = fan_pixels(ping, 600)
    axes.imshow(picture, origin="lower", extent=extent, cmap="copper", vmin=0, vmax=1)
    axes.set_axis_off()
    axes.set_title(title, fontsize=9, color=INK)


def main() -> None:
    """Make all of them; those of recordings only where the data lies beside the project."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--presets", action="store_true", help="only the sheet of all sonars")
    if parser.parse_args().presets:
        presets()
        return
    scan()
    experiments()
    sphere()
    if missing():
        print(f"report.png and view.png stay as they are: {missing()}")
    else:
        pages()
    if RECORDINGS.is_dir():
        real()
        views()
        presets()
    else:
        kept = "real-and-simulated.png, dataset.png and presets.png stay as they are"
        print(f"{RECORDINGS} is not here; {kept}")


if __name__ == "__main__":
    main()
