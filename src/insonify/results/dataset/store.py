"""A dataset as a Zarr store (version 3) that xarray opens: one chunk a view."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from insonify.extras import optional
from insonify.imaging.collection import Collection
from insonify.imaging.route import Shot
from insonify.io.recordings.recording import Recording
from insonify.results.dataset.coco import categories_of
from insonify.types import POSE, Array, FanGeometry, Float64, Ping, Pose, PosedPing

PIXELWISE: dict[str, tuple[type, Any, dict[str, str]]] = {
    "image": (np.float32, float("nan"), {"long_name": "intensity", "units": "1"}),
    "label": (np.int16, -2, {"long_name": "index into the attribute labels, -1 for nothing"}),
    "elevation_rad": (np.float32, float("nan"), {"long_name": "elevation", "units": "rad"}),
    "range_m": (np.float32, float("nan"), {"long_name": "range of the surface", "units": "m"}),
    "first_return": (np.bool_, False, {"long_name": "nearest echo of its beam"}),
    "shadow": (np.bool_, False, {"long_name": "hidden by what lies before"}),
}
"""Variables over (view, bin, beam): type, what stands for a chunk not written, attributes."""


def create(path: Path, views: Collection) -> None:
    """Make a store for all views, empty yet.

    Raises:
        MissingExtraError: The package zarr is not installed.
    """
    zarr = optional("zarr", "datasets", "a dataset")
    config, fan = views.config, views.geometry
    about = {
        "title": f"insonify dataset of {', '.join(config.names)}",
        "worlds": list(config.names),
        "parts": list(config.parts),
        "labels": list(views.labels),
        "categories": categories_of(views.labels),
        "sonar": config.sonar.name,
        "model": config.model,
        "seed": config.seed,
        "azimuth_fov_rad": fan.azimuth_fov_rad,
        "elevation_fov_rad": fan.elevation_fov_rad,
        "range_min_m": fan.range_min_m,
        "range_max_m": fan.range_max_m,
        "mount_x_y_z_roll_pitch_yaw": [
            *fan.mount.position_m, fan.mount.roll_rad, fan.mount.pitch_rad, fan.mount.yaw_rad,
        ],
    }  # fmt: skip
    group = zarr.create_group(path, zarr_format=3, attributes=about)
    for name, (kind, nothing, attributes) in PIXELWISE.items():
        group.create_array(
            name,
            shape=(config.count, fan.bins, fan.beams),
            chunks=(1, fan.bins, fan.beams),
            dtype=kind,
            fill_value=nothing,
            compressors=[zarr.codecs.ZstdCodec(level=3)],
            dimension_names=("view", "bin", "beam"),
            attributes=attributes,
        )


def write(path: Path, shot: Shot) -> None:
    """Write the pixels of a view."""
    zarr = optional("zarr", "datasets", "a dataset")
    assert shot.truth is not None
    group = zarr.open_group(path, mode="r+", zarr_format=3)
    for name in PIXELWISE:
        pixels = shot.posed.ping.image if name == "image" else getattr(shot.truth, name)
        group[name][shot.number] = pixels


def finish(path: Path, views: Collection, poses: list[list[float]]) -> None:
    """Write what is of all views: the poses, and where bins and beams lie."""
    zarr = optional("zarr", "datasets", "a dataset")
    group = zarr.open_group(path, mode="r+", zarr_format=3)
    columns: Float64 = np.array(poses, np.float64).reshape(-1, 6).T
    _line(group, "view", np.arange(len(poses)), "view", {"long_name": "number of the view"})
    worlds = np.array([views.world(number) for number in range(len(poses))], np.int32)
    of = {"long_name": "index into the attributes worlds and parts"}
    _line(group, "world", worlds, "view", of)
    ranges = {"long_name": "centre range of the bin", "units": "m"}
    _line(group, "bin_range_m", views.geometry.bin_ranges_m, "bin", ranges)
    azimuths = {"long_name": "centre azimuth of the beam, to port", "units": "rad"}
    _line(group, "azimuth_rad", views.geometry.beam_azimuths_rad, "beam", azimuths)
    for name, values in zip(POSE, columns, strict=True):
        what, units = name.split("_")
        about = {"long_name": f"{what} of the vehicle", "units": units}
        _line(group, name, values, "view", about)
    group.attrs["coordinates"] = " ".join(("bin_range_m", "azimuth_rad", "world", *POSE))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that it is an extension of Zarr; xarray wants it
        zarr.consolidate_metadata(path)


def as_recording(path: Path) -> Recording:
    """The views of a whole store as pings without times, in their order."""
    zarr = optional("zarr", "datasets", "a dataset")
    group = zarr.open_group(path, mode="r", zarr_format=3)
    told = dict(group.attrs)
    poses = np.stack([group[name][:] for name in POSE], axis=1)
    count, bins, beams = group["image"].shape
    fan = FanGeometry(
        azimuth_fov_rad=told["azimuth_fov_rad"],
        elevation_fov_rad=told["elevation_fov_rad"],
        beams=beams,
        bins=bins,
        range_min_m=told["range_min_m"],
        range_max_m=told["range_max_m"],
        mount=Pose(*told["mount_x_y_z_roll_pitch_yaw"]),
    )

    def read() -> Iterator[PosedPing]:
        for number in range(count):
            image = np.ascontiguousarray(group["image"][number], np.float32)
            yield PosedPing(Ping(image, fan, float(number)), Pose(*map(float, poses[number])))

    facts = {"poses": f"{count}, where they were simulated"}
    return Recording(path, "dataset", count, False, facts, read, exact=True)


def tidy(path: Path) -> None:
    """Remove what a killed process left half-written."""
    for file in path.rglob("*.partial"):
        file.unlink()


def _line(group: Any, name: str, values: Array, along: str, attributes: dict[str, str]) -> None:
    array = group.create_array(
        name, shape=values.shape, chunks=values.shape, dtype=values.dtype, fill_value=0,
        dimension_names=(along,), attributes=attributes, overwrite=True,
    )  # fmt: skip
    array[:] = values
