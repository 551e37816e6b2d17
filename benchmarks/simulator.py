"""The simulator's tables: ``python -m benchmarks.simulator [--quick]``.

``--quick`` (one minute) gives ratios to yardsticks timed in turn with what is measured: a normal
draw of numpy's for each pixel, and a plain cast of Embree's along the even rays of a ping.

Without it: the paper's Tables 1 and 2 for both renderers with the error of each image, every preset
against its device's own rate, and growth over triangles, beams and bins (docs/images/growth.png).
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from benchmarks.measure import machine
from insonify.errors import RendererError
from insonify.frames import world_from_sonar
from insonify.report.fans import png
from insonify.scene import Body, Material, Scene
from insonify.scene.meshes import place_mesh, scaled
from insonify.scene.objects import shipwreck
from insonify.scene.seabed import procedural_seabed
from insonify.sonar import RendererName, Sonar, renderer_named
from insonify.sonar.devices import Kind, SonarDevice, named_device, sonar_presets
from insonify.sonar.embree import EmbreeRenderer
from insonify.sonar.formation import ImageSettings, form_image, normalise_energy
from insonify.sonar.histogram import Renderer
from insonify.sonar.patches import even_grid
from insonify.sonar.physical import PhysicalSettings, Receiver, form_physical
from insonify.sonar.sampling import SamplingSettings, even_samples
from insonify.sonar.speckle import SpeckleField
from insonify.types import Float32, Pose

FRAMES = 500
REFERENCE = 8
"""The reference has so many times the samples each way, 64 times in all."""

PAPER_ROWS = (  # beams, bins, field of view in degrees, the paper's ms
    (128, 500, 120, 20, 54.7),
    (128, 1000, 120, 20, 72.3),
    (256, 500, 120, 20, 198.7),
    (256, 1000, 120, 20, 218.2),
    (128, 500, 90, 15, 77.4),
    (128, 1000, 90, 15, 94.6),
    (256, 500, 90, 15, 260.8),
    (256, 1000, 90, 15, 268.7),
    (1, 500, 3, 35, 8.8),
    (1, 1000, 3, 35, 34.5),
    (1, 500, 2, 20, 10.3),
    (1, 1000, 2, 20, 41.7),
)


def world(cells: int = 320, range_m: float = 20.0) -> Scene:
    """Three wrecks on a relief of 2 x cells^2 triangles, for a sonar of some range."""
    size_m = 4.0 * range_m
    seabed = procedural_seabed(
        np.random.default_rng(3), size_m=size_m, depth_m=0.0, relief_m=0.01 * range_m,
        correlation_m=0.15 * range_m, cell_m=size_m / cells,
    )  # fmt: skip
    bodies = []
    for k, (x, y) in enumerate(((0.35, 0.1), (-0.3, 0.3), (0.0, -0.45))):
        wreck = scaled(shipwreck(), range_m / 20.0)
        turned = place_mesh(wreck, x * range_m, y * range_m, -0.02 * range_m, np.eye(3))
        bodies.append(Body(f"wreck {k}", turned, Material("steel", 1.4)))
    return Scene(tuple(bodies), seabed)


def poses(count: int, range_m: float = 20.0) -> list[Pose]:
    """Poses around the wrecks, looking in and down."""
    found = []
    for k in range(count):
        angle = math.tau * k / count
        x, y = 0.55 * range_m * math.cos(angle), 0.55 * range_m * math.sin(angle)
        found.append(
            Pose(x, y, 0.25 * range_m, pitch_rad=math.radians(25.0), yaw_rad=angle + math.pi)
        )
    return found


def triangles(scene: Scene) -> int:
    """How many triangles a scene has."""
    return sum(len(faces) for _, faces in scene.meshes)


@dataclass(frozen=True)
class Timing:
    """Milliseconds of a frame: mean, standard deviation, median."""

    mean_ms: float
    std_ms: float
    median_ms: float


def timed(sonar: Sonar, scene: Scene, where: list[Pose]) -> Timing:
    """Time complete images, noise and all, from poses; one is not counted."""
    rng = np.random.default_rng(0)
    sonar.ping(scene, where[0], rng)
    spent = []
    for pose in where:
        start = time.perf_counter()
        sonar.ping(scene, pose, rng)
        spent.append(1e3 * (time.perf_counter() - start))
    return Timing(statistics.mean(spent), statistics.stdev(spent), statistics.median(spent))


def error(sonar: Sonar, scene: Scene, where: list[Pose]) -> float:
    """RMS of the image before noise against 64 times the samples, share of full scale."""
    geometry = sonar.device.geometry
    across, over = even_samples(geometry, SamplingSettings())
    fine = SamplingSettings(across_beam=REFERENCE * across, over_elevation=REFERENCE * over)
    reference = Sonar(sonar.device, renderer=renderer_named(RendererName.EMBREE, fine))

    def image(of: Sonar, pose: Pose) -> Float32:
        assert of.renderer is not None
        return normalise_energy(of.renderer.render(scene, geometry, pose, of.response))

    squares = [np.mean((image(sonar, p) - image(reference, p)) ** 2) for p in where]
    return float(np.sqrt(np.mean(squares)))


def paper_tables(frames: int = FRAMES) -> Iterator[dict[str, object]]:
    """Tables 1 and 2 with both renderers."""
    scene, around = world(), poses(frames)
    for name in RendererName:
        try:
            renderer = renderer_named(name, SamplingSettings())
        except RendererError as err:
            print(f"{name}: {err}")
            continue
        for beams, bins, az, el, paper_ms in PAPER_ROWS:
            device = SonarDevice(
                azimuth_fov_deg=az, elevation_fov_deg=el, beams=beams, bins=bins,
                range_max_m=20.0, tilt_deg=0.0,
            )  # fmt: skip
            sonar = Sonar(device, renderer=renderer)
            spent = timed(sonar, scene, around)
            yield {
                "renderer": name.value,
                "beams": beams,
                "bins": bins,
                "fov": f"{az} x {el}",
                "mean_ms": spent.mean_ms,
                "std_ms": spent.std_ms,
                "fps": 1e3 / spent.mean_ms,
                "paper_ms": paper_ms,
                "ratio": paper_ms / spent.mean_ms,
                "error": error(sonar, scene, around[:: max(1, frames // 5)]),
            }


def preset_table(frames: int = 15) -> Iterator[dict[str, object]]:
    """Every preset at its full beams and bins against its own ping rate."""
    for name in sonar_presets():
        device = named_device(name)
        range_m = device.range_max_m
        scene, around = world(range_m=range_m), poses(frames, range_m)
        spent = timed(Sonar(device), scene, around)
        heads = 2 if device.kind is Kind.SIDESCAN else 1
        own_hz = 1.0 / device.interval_s(1500.0)
        ours_hz = 1e3 / (heads * spent.median_ms)
        yield {"preset": name, "pings/s": ours_hz, "device_hz": own_hz, "ratio": ours_hz / own_hz}


_MANY = 20
"""Pings in one call of `Sonar.pings`, beside one by one."""
QUICK = ("park-2025", "gemini-720is", "oculus-m750d-1200khz", "oculus-m1200d-2100khz", "ping360")


def quick_table(rounds: int = 15) -> Iterator[dict[str, object]]:
    """Whole pings and image formation alone, in draws and casts of the same round."""
    for name in QUICK:
        device = named_device(name)
        scene = world(range_m=device.range_max_m)
        spent: dict[str, list[float]] = {}
        for key, pose in enumerate(poses(rounds, device.range_max_m)):
            for what, function in _jobs(device, scene, pose, key).items():
                start = time.perf_counter()
                function()
                spent.setdefault(what, []).append(time.perf_counter() - start)
        middle = {what: statistics.median(times[1:]) for what, times in spent.items()}
        draw_s, cast_s = middle["draw"], middle["cast"]
        yield {
            "preset": name,
            "pixels": f"{device.beams} x {device.bins}",
            "ping, draws": middle["ping"] / draw_s,
            "ping, casts": middle["ping"] / cast_s,
            "of many, casts": middle["many"] / _MANY / cast_s,
            "physical, draws": middle["physical"] / draw_s,
            "forming, draws": middle["forming"] / draw_s,
            "forming physical, draws": middle["forming physical"] / draw_s,
        }


def _jobs(
    device: SonarDevice, scene: Scene, pose: Pose, key: int
) -> dict[str, Callable[[], object]]:
    """The yardsticks and what is measured by them, from one pose."""
    geometry, rng = device.geometry, np.random.default_rng(key)
    plain, physical = Sonar(device), Sonar(device, physical=PhysicalSettings())
    receiver, field = Receiver(device, PhysicalSettings()), SpeckleField()
    echoes = EmbreeRenderer().render(scene, geometry, pose, plain.response)
    grid = even_grid(geometry, *even_samples(geometry, SamplingSettings()))
    there = world_from_sonar(pose, geometry.mount)
    rays = (grid.directions @ there[:3, :3].T).astype(np.float32)
    return {
        "draw": lambda: rng.standard_normal((geometry.bins, geometry.beams), dtype=np.float32),
        "cast": lambda: scene.cast(there[:3, 3], rays, geometry.range_max_m),
        "ping": lambda: plain.ping(scene, pose, rng),
        "many": lambda: list(plain.pings(scene, [pose] * _MANY, rng)),
        "physical": lambda: physical.ping(scene, pose, rng),
        "forming": lambda: form_image(echoes, ImageSettings(), key),
        "forming physical": lambda: form_physical(echoes, geometry, receiver, field, pose, key),
    }


Curves = dict[str, tuple[list[float], list[float]]]


def growth() -> dict[str, Curves]:
    """Milliseconds against triangles, beams and bins, by renderer."""
    scenes = [world(cells) for cells in (70, 158, 320, 707, 1224)]
    found: dict[str, Curves] = {}
    for name in RendererName:
        try:
            renderer = renderer_named(name, SamplingSettings())
        except RendererError:
            continue
        by_size = [_median_ms(renderer, scene, 128, 500) for scene in scenes]
        found[name.value] = {"triangles": ([float(triangles(s)) for s in scenes], by_size)}
        beams, bins = [32, 64, 128, 256, 512, 1024], [125, 250, 500, 1000, 2000, 4000]
        by_beams = [_median_ms(renderer, scenes[2], count, 500) for count in beams]
        by_bins = [_median_ms(renderer, scenes[2], 128, count) for count in bins]
        found[name.value]["beams"] = ([float(count) for count in beams], by_beams)
        found[name.value]["bins"] = ([float(count) for count in bins], by_bins)
    return found


def _median_ms(renderer: Renderer, scene: Scene, beams: int, bins: int) -> float:
    device = SonarDevice(
        azimuth_fov_deg=120, elevation_fov_deg=20, beams=beams, bins=bins, range_max_m=20,
        tilt_deg=0,
    )  # fmt: skip
    return timed(Sonar(device, renderer=renderer), scene, poses(12)).median_ms


def exponent(x: list[float], y: list[float]) -> float:
    """Of the power law that fits best."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def draw_growth(found: dict[str, Curves]) -> bytes:
    """The growth curves with their exponents."""
    figure = Figure(figsize=(11.0, 3.6), layout="constrained")
    panels = figure.subplots(1, 3, sharey=True)
    for axes, what in zip(panels, ("triangles", "beams", "bins"), strict=True):
        for name, curves in found.items():
            x, y = curves[what]
            axes.loglog(x, y, "o-", ms=4, label=f"{name}: exponent {exponent(x, y):.2f}")
        axes.set_xlabel(what)
        axes.grid(alpha=0.3, which="both")
        axes.legend(fontsize=8)
    panels[0].set_ylabel("ms a ping")
    return png(figure)


def _show(title: str, rows: list[dict[str, object]]) -> None:
    table = Table(title=title)
    for key in rows[0]:
        table.add_column(key)
    for row in rows:
        cells = (
            f"{value:.3g}" if isinstance(value, float) else str(value) for value in row.values()
        )
        table.add_row(*cells)
    Console(width=120).print(table)


def main() -> None:
    """Print all tables and write them to ``build/simulator.json``."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="ratios to yardsticks only")
    print(machine())
    if parser.parse_args().quick:
        _show("Pings in normal draws and plain casts", list(quick_table()))
        return
    size = f"{FRAMES} frames, {triangles(world()):,} triangles"
    parts: dict[str, Callable[[], Iterator[dict[str, object]]]] = {
        f"Cerqueira et al. 2017, Tables 1 and 2: {size}": paper_tables,
        "Presets at full beams and bins, Embree, against the device's own rate": preset_table,
    }
    written: dict[str, object] = {"machine": machine()}
    for title, part in parts.items():
        rows = list(part())
        _show(title, rows)
        written[title] = rows
    curves = growth()
    for name, by in curves.items():
        for what, (x, y) in by.items():
            points = ", ".join(f"{a:g}: {b:.1f} ms" for a, b in zip(x, y, strict=True))
            print(f"{name}, {what}: exponent {exponent(x, y):.2f}; {points}")
    written["growth"] = curves
    Path("build").mkdir(exist_ok=True)
    Path("build/simulator.json").write_text(json.dumps(written, indent=2) + "\n", encoding="utf-8")
    Path("docs/images/growth.png").write_bytes(draw_growth(curves))


if __name__ == "__main__":
    main()
