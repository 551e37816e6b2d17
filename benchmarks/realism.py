"""Simulated images beside recorded ones, in figures: ``python -m benchmarks.realism [FOLDER]``.

Frames of an ARIS Explorer 1200 and pings of an Oculus M1200d (2.1 MHz), and pings of the same fans
over sand and stones by each of the image models.  The scenes that were recorded are not known, so
what is compared does not hang on them: how even regions look.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np
import trimesh
from rich.console import Console
from rich.table import Table
from scipy.ndimage import uniform_filter

from insonify.io.recordings import open_recording
from insonify.scene import Body, Material, Scene
from insonify.scene.materials import material_named
from insonify.scene.seabed import procedural_seabed
from insonify.sonar import Sonar
from insonify.sonar.devices import SonarDevice, named_device
from insonify.sonar.physical import PhysicalSettings
from insonify.types import FanGeometry, Float32, Float64, Pose

RECORDINGS = Path("../shared/data/recordings")
FRAMES = 8
TWINS: tuple[tuple[str, str, str, dict[str, float]], ...] = (
    ("ARIS", "sample.aris", "aris-1200", {"beamwidth_deg": 0.3}),  # its lens for half the fan
    ("Oculus", "oculus_three_pings_8bit.raw", "oculus-m1200d-2100khz", {}),
)
"""Recordings, and what they were made with: a preset, and what is known besides."""
WINDOW = (31, 7)
"""Bins and beams over which an image's local mean is taken."""
EVEN = 0.25
"""The share of an image that is taken to be even: where its mean changes least."""


@dataclass(frozen=True)
class Figures:
    """What is compared: means over frames, each image in [0, 1].

    Attributes:
        zeros: Share of pixels that are exactly 0.
        contrast: Standard deviation over mean in even regions.
        range_cells: Lag at which the autocorrelation there falls to 1/e, along range.
        beam_cells: The same across beams.
        dynamic_db: 20 log10 of the 99th over the 1st percentile.
        shadow: 2nd percentile over the median.
    """

    zeros: float
    contrast: float
    range_cells: float
    beam_cells: float
    dynamic_db: float
    shadow: float


def figures(images: list[Float32]) -> Figures:
    """Of some images of one sonar."""
    found = np.array([_of_one(image.astype(np.float64)) for image in images])
    return Figures(*found.mean(axis=0).tolist())


def _of_one(image: Float64) -> tuple[float, ...]:
    mean = uniform_filter(image, WINDOW)
    wider = uniform_filter(mean, WINDOW)
    change = uniform_filter(np.abs(mean - wider) / np.maximum(mean, 1e-6), WINDOW)
    heard = mean > 0.5 * np.median(mean)
    even = heard & (change <= np.quantile(change[heard], EVEN))
    rest = image / np.maximum(mean, 1e-6) - 1.0
    low, dark, middle, high = np.quantile(image, (0.01, 0.02, 0.5, 0.99))
    return (
        float((image == 0.0).mean()),
        float(rest[even].std()),
        _length(rest, even, 0),
        _length(rest, even, 1),
        20.0 * math.log10(high / max(low, 1e-6)),
        float(dark / middle),
    )


def _length(rest: Float64, even: np.ndarray, axis: int) -> float:
    """The lag, in cells, at which what is left of even regions is alike by 1/e, interpolated."""
    rest, even = np.moveaxis(rest, axis, 0), np.moveaxis(even, axis, 0)
    power, before = float(np.mean(rest[even] ** 2)), 1.0
    for lag in range(1, 16):
        both = even[lag:] & even[:-lag]
        alike = float(np.mean((rest[lag:] * rest[:-lag])[both])) / power
        if alike < 1.0 / math.e:
            return lag - 1 + (before - 1.0 / math.e) / (before - alike)
        before = alike
    return 15.0


def twin(preset: str, geometry: FanGeometry, **known: float) -> SonarDevice:
    """A preset with the fan of a recorded ping."""
    return named_device(preset).model_copy(
        update={
            "azimuth_fov_deg": math.degrees(geometry.azimuth_fov_rad),
            "beams": geometry.beams,
            "bins": geometry.bins,
            "range_min_m": geometry.range_min_m,
            "range_max_m": geometry.range_max_m,
            "tilt_deg": 0.0,
            **known,
        }
    )


def sand(range_m: float) -> Scene:
    """A rippled seabed with stones, for a sonar of some range."""
    rng = np.random.default_rng(4)
    seabed = procedural_seabed(
        rng, size_m=3.0 * range_m, depth_m=0.0, relief_m=0.003 * range_m,
        correlation_m=0.1 * range_m, cell_m=range_m / 100.0,
    )  # fmt: skip
    rock = material_named("rock") or Material("rock")
    bodies = []
    for k in range(12):
        stone = trimesh.creation.icosphere(2, range_m * rng.uniform(0.01, 0.03))
        x, y = range_m * rng.uniform(0.2, 0.9), range_m * rng.uniform(-0.3, 0.3)
        stone.apply_translation((x, y, 0.0))
        bodies.append(Body(f"stone {k}", stone, rock))
    return Scene(tuple(bodies), seabed, material_named("sand") or Material("sand"))


def simulated(device: SonarDevice, physical: PhysicalSettings | None) -> list[Float32]:
    """Images over sand from a tenth of the range above, looking at its middle."""
    scene, far_m = sand(device.range_max_m), device.range_max_m
    sonar, rng = Sonar(device, physical=physical), np.random.default_rng(1)
    pitch_rad = math.atan2(0.1 * far_m, 0.5 * far_m)
    start = Pose(0.0, 0.0, 0.1 * far_m, pitch_rad=pitch_rad)
    poses = [replace(start, x_m=0.01 * far_m * k) for k in range(FRAMES)]
    return [sonar.ping(scene, pose, rng).image for pose in poses]


def table(folder: Path) -> Iterator[tuple[str, Figures]]:
    """The rows: recorded, physical and cerqueira, for each device."""
    for name, file, preset, known in TWINS:
        recorded = [posed.ping for posed in islice(open_recording(folder / file), FRAMES)]
        device = twin(preset, recorded[0].geometry, **known)
        yield f"{name}, recorded", figures([ping.image for ping in recorded])
        yield f"{name}, physical", figures(simulated(device, PhysicalSettings()))
        yield f"{name}, cerqueira", figures(simulated(device, None))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", default=RECORDINGS)
    shown = Table(title="Recorded and simulated images")
    for column in (
        "", "zeros", "speckle contrast", "range cells", "beam cells", "1 to 99 %, dB", "shadow"
    ):  # fmt: skip
        shown.add_column(column)
    for name, found in table(parser.parse_args().folder):
        values = (
            found.zeros, found.contrast, found.range_cells, found.beam_cells, found.dynamic_db,
            found.shadow,
        )  # fmt: skip
        shown.add_row(name, *(f"{value:.3g}" for value in values))
    Console(width=100).print(shown)


if __name__ == "__main__":
    main()
