"""Pings as files: image, geometry, time, pose and truth, which load back as they were."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from insonify.errors import RecordingError
from insonify.io.archives import read_archive
from insonify.sonar.truth import Truth
from insonify.types import Array, FanGeometry, Ping, Pose, PosedPing

PING, SWEEP, VERSION = "insonify-ping", "insonify-sweep", 1
FAN = ("azimuth_fov_rad", "elevation_fov_rad", "range_min_m", "range_max_m")
_PIXELWISE = ("label", "elevation_rad", "range_m", "point_m", "first_return", "shadow")


def save_ping(path: Path, posed: PosedPing, truth: Truth | None = None) -> None:
    """Write a ping as a NumPy archive.

    Arrays: ``format``, ``version``, ``image`` (bins, beams) float32 in [0, 1], the first beam to
    port; ``azimuth_fov_rad``, ``elevation_fov_rad``, ``range_min_m`` and ``range_max_m``; ``mount``
    and ``pose``: x, y, z (m), roll, pitch, yaw (rad) of the sonar on the body and of the body in
    the world; ``time_s``; with truth also ``labels`` and the arrays of
    `insonify.sonar.truth.Truth`.
    """
    ping = posed.ping
    arrays = {"image": ping.image, "time_s": np.array(ping.time_s), "pose": _six(posed.pose)}
    arrays |= _geometry_arrays(ping.geometry)
    if truth is not None:
        arrays["labels"] = np.array(truth.labels)
        arrays |= {name: getattr(truth, name) for name in _PIXELWISE}
    _write(path, PING, arrays)


def load_ping(path: Path | str) -> tuple[PosedPing, Truth | None]:
    """Read a ping written by `save_ping`, and the truth of its pixels if it was saved too.

    Raises:
        RecordingError: The file is missing, is no such ping, or is damaged.
    """
    path = Path(path)
    arrays = read_archive(path, PING, VERSION, RecordingError)
    try:
        image = arrays["image"]
        if image.ndim != 2 or image.dtype != np.float32:
            raise ValueError(f"its image is {image.dtype} of shape {image.shape}")
        geometry = _geometry(arrays, image)
        ping = Ping(image, geometry, float(arrays["time_s"]))
        truth = None
        if "labels" in arrays:
            labels = tuple(str(name) for name in arrays["labels"])
            truth = Truth(labels, **{name: arrays[name] for name in _PIXELWISE})
        return PosedPing(ping, _pose(arrays["pose"])), truth
    except (KeyError, ValueError, TypeError, IndexError) as err:
        raise RecordingError(f"{path}: damaged, it lacks or garbles an array ({err})") from err


def save_sweep(
    path: Path, pings: Sequence[PosedPing], polar: Ping, deskewed: Ping, truths: Sequence[Truth]
) -> None:
    """Write a turn of a scanning head as a NumPy archive.

    Arrays: ``raw`` (bins, steps) float32 in the order in which the pings were sent, with
    ``head_rad``, ``times_s``, ``poses`` and ``mounts`` (steps, 6) of each and ``beam_rad``, their
    width; ``image`` and ``deskewed`` (bins,
    steps) from port to starboard, with their fan, ``mount`` and ``pose``, the first ping's, as in
    `save_ping`; with truth ``labels`` and the arrays of `Truth`, in the order of ``raw``.
    """
    arrays = {
        "image": polar.image,
        "deskewed": deskewed.image,
        "raw": np.concatenate([one.ping.image for one in pings], axis=1),
        "head_rad": np.array([one.ping.head_rad for one in pings]),
        "times_s": np.array([one.ping.time_s for one in pings]),
        "poses": np.array([_six(one.pose) for one in pings]),
        "mounts": np.array([_six(one.ping.geometry.mount) for one in pings]),
        "beam_rad": np.array(pings[0].ping.geometry.azimuth_fov_rad),
        "pose": _six(pings[0].pose),
        "time_s": np.array(polar.time_s),
    }
    arrays |= _geometry_arrays(polar.geometry)
    if truths:
        arrays["labels"] = np.array(truths[0].labels)
        for name in _PIXELWISE:
            arrays[name] = np.concatenate([getattr(truth, name) for truth in truths], axis=1)
    _write(path, SWEEP, arrays)


def is_sweep(path: Path) -> bool:
    """Whether a file is one of `save_sweep`."""
    try:
        read_archive(path, SWEEP, VERSION, RecordingError)
    except RecordingError:
        return False
    return True


def load_sweep(path: Path) -> list[PosedPing]:
    """The pings of a turn written by `save_sweep`, each a fan of one beam.

    Raises:
        RecordingError: The file is no such turn, an older one, or damaged.
    """
    arrays = read_archive(path, SWEEP, VERSION, RecordingError)
    if "mounts" not in arrays:
        raise RecordingError(f"{path}: a turn of an earlier version, without mounts; make it again")
    try:
        _, height, near, far = fan_figures(arrays)
        width, raw = float(arrays["beam_rad"]), arrays["raw"]
        columns = zip(
            raw.T, arrays["times_s"], arrays["poses"], arrays["mounts"], arrays["head_rad"],
            strict=True,
        )  # fmt: skip
        return [
            PosedPing(
                Ping(
                    np.ascontiguousarray(column[:, None], np.float32),
                    FanGeometry(width, height, 1, len(column), near, far, _pose(mount)),
                    float(time_s),
                    float(head_rad),
                ),
                _pose(pose),
            )
            for column, time_s, pose, mount, head_rad in columns
        ]
    except (KeyError, ValueError, TypeError, IndexError) as err:
        raise RecordingError(f"{path}: damaged, it lacks or garbles an array ({err})") from err


def save_sidescan(
    path: Path,
    image: Array,
    bin_m: float,
    posed: Sequence[PosedPing],
    labels: Sequence[str],
    truth: Mapping[str, Array],
) -> None:
    """Write a side-scan image as a NumPy archive.

    Arrays: ``image`` (lines, 2 x bins) float32, port from far to near and then starboard, the first
    line last; ``bin_m``; ``times_s`` (lines,) and ``poses`` (lines, 6), the first line first; with
    truth ``labels``, and ``label`` and ``shadow``, laid out as the image.
    """
    arrays = {
        "image": image,
        "bin_m": np.array(bin_m),
        "times_s": np.array([one.ping.time_s for one in posed]),
        "poses": np.array([_six(one.pose) for one in posed]),
    }
    if truth:
        arrays |= {"labels": np.array(labels), **truth}
    _write(path, "insonify-sidescan", arrays)


def _write(path: Path, form: str, arrays: dict[str, Array]) -> None:
    with path.open("wb") as file:
        np.savez_compressed(
            file, format=np.array(form), version=np.array(VERSION), allow_pickle=False, **arrays
        )


def _six(pose: Pose | None) -> Array:
    assert pose is not None
    return np.array(pose.numbers)


def _pose(six: Array) -> Pose:
    x, y, z, roll, pitch, yaw = (float(value) for value in six)
    return Pose(x, y, z, roll, pitch, yaw)


def fan_arrays(geometry: FanGeometry) -> dict[str, Array]:
    """The figures of a fan, each an array by its name."""
    return {name: np.array(getattr(geometry, name)) for name in FAN}


def fan_figures(arrays: Mapping[str, Array]) -> tuple[float, float, float, float]:
    """The figures of a fan in the order of `FAN`; earlier files have them in one array, ``fan``.

    Raises:
        KeyError: One is missing.
    """
    told = arrays["fan"] if "fan" in arrays else [arrays[name] for name in FAN]
    azimuth, elevation, near, far = (float(value) for value in told)
    return azimuth, elevation, near, far


def _geometry_arrays(geometry: FanGeometry) -> dict[str, Array]:
    return fan_arrays(geometry) | {"mount": _six(geometry.mount)}


def _geometry(arrays: Mapping[str, Array], image: Array) -> FanGeometry:
    azimuth, elevation, near, far = fan_figures(arrays)
    bins, beams = image.shape
    return FanGeometry(azimuth, elevation, beams, bins, near, far, _pose(arrays["mount"]))
