"""Recordings as NumPy archives (``.npz``): arrays of images and poses, and the fan's figures.

The layout is described in docs/recordings.md.  Sizes are checked before arrays are made, and
nothing is unpickled.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from insonify.errors import RecordingError, reason
from insonify.frames import pose_from_transform, transform_from_pose
from insonify.io.archives import DAMAGE, check_sizes
from insonify.io.recordings.beams import unit_pixels
from insonify.io.recordings.recording import (
    SEAT_UNKNOWN,
    SIDE_UNKNOWN,
    Reading,
    Recording,
    scaled,
)
from insonify.io.recordings.simulated import TOUR, read_tour
from insonify.limits import MOST_PIXELS
from insonify.types import Array, FanGeometry, Float64, Ping, Pose, PosedPing

_KNOWN = {
    "images", "time_s", "pose_body", "pose_sensor", "mount", "columns",
    "range_min_m", "range_max_m", "azimuth_deg", "elevation_deg",
}  # fmt: skip


def read_arrays(path: Path, reading: Reading) -> Recording:
    """Open a recording of arrays.

    Raises:
        RecordingError: The file is damaged, or its arrays are not those of a recording.
    """
    try:
        with path.open("rb") as file:
            check_sizes(path, _KNOWN | TOUR, RecordingError)
            archive = np.load(file, allow_pickle=False)
            if "log_odds" in archive.files:
                raise RecordingError(f"{path}: a map, not a recording; see `insonify plan`")
            if set(archive.files) >= TOUR:
                return read_tour(path, reading)
            arrays = {name: archive[name] for name in archive.files if name in _KNOWN}
    except DAMAGE as err:
        raise RecordingError(f"{path}: damaged, or not a NumPy archive ({reason(err)})") from err
    images = _images(path, arrays)
    mount = _mount(path, arrays, reading)
    seat = mount if reading.mount is None else reading.mount
    geometry = _geometry(path, arrays, images, reading, seat)
    times = _times(path, arrays, len(images))
    poses = _poses(path, arrays, len(images), mount)
    port_first = not _starboard_first(path, arrays)
    starboard_first = port_first == reading.mirrors(port_first)
    reading, doubts = scaled(reading, images.dtype, lambda: int(images.max()))
    if "columns" not in arrays and reading.beams is None:
        doubts.append(SIDE_UNKNOWN.format("starboard"))
    own = reading.poses is None and "pose_body" in arrays
    seated = "mount" in arrays or reading.mount is not None or reading.device is not None
    if not seated and (own or reading.poses is not None):
        doubts.append(SEAT_UNKNOWN)

    def read() -> Iterator[PosedPing]:
        for number, pixels in enumerate(images):
            try:
                ordered = pixels[:, ::-1] if starboard_first else pixels
                image = unit_pixels(ordered, reading.full_scale)
            except ValueError as err:
                raise RecordingError(f"{path}: image {number + 1}: {err}") from err
            time_s = float(number if times is None else times[number])
            yield PosedPing(Ping(image, geometry, time_s), poses[number] if poses else None)

    facts = {
        "pixels": str(images.dtype),
        "columns": reading.columns(port_first),
        "poses": "none" if poses is None else f"{len(poses)} in the file",
        "doubts": doubts,
    }
    return Recording(path, "NumPy arrays", len(images), times is not None, facts, read)


def save_arrays(path: Path, pings: list[PosedPing]) -> None:
    """Write pings of one geometry as an archive that `read_arrays` takes back, poses and all.

    Raises:
        RecordingError: There are no pings, their geometries differ, or only some have a pose.
    """
    if not pings:
        raise RecordingError(f"{path}: there are no pings to write")
    geometry = pings[0].ping.geometry
    if any(recorded.ping.geometry != geometry for recorded in pings):
        raise RecordingError(f"{path}: the pings' geometries differ; write one archive for each")
    poses = [recorded.pose for recorded in pings if recorded.pose is not None]
    if poses and len(poses) < len(pings):
        raise RecordingError(f"{path}: {len(pings) - len(poses)} of the pings have no pose")
    arrays: dict[str, Array] = {
        "images": np.stack([recorded.ping.image for recorded in pings]),
        "columns": np.array("port_to_starboard"),
        "time_s": np.array([recorded.ping.time_s for recorded in pings]),
        "range_min_m": np.array(geometry.range_min_m),
        "range_max_m": np.array(geometry.range_max_m),
        "azimuth_deg": np.array(math.degrees(geometry.azimuth_fov_rad)),
        "elevation_deg": np.array(math.degrees(geometry.elevation_fov_rad)),
        "mount": np.array(_numbers(geometry.mount)),
    }
    if poses:
        arrays["pose_body"] = np.array([_numbers(pose) for pose in poses])
    with path.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)


def _numbers(pose: Pose) -> list[float]:
    return [*pose.position_m, pose.roll_rad, pose.pitch_rad, pose.yaw_rad]


def _images(path: Path, arrays: dict[str, Array]) -> Array:
    images = arrays.get("images")
    if images is None or images.ndim != 3 or images.dtype.kind not in "uif" or 0 in images.shape:
        what = "no array `images`" if images is None else f"`images` of shape {images.shape}"
        raise RecordingError(
            f"{path}: {what}; a recording holds images of shape (pings, bins, beams), whole "
            "or floating (docs/recordings.md)"
        )
    if images.shape[1] * images.shape[2] > MOST_PIXELS:
        raise RecordingError(f"{path}: images of {images.shape[1:]} pixels are too large")
    return images


def _geometry(
    path: Path, arrays: dict[str, Array], images: Array, reading: Reading, mount: Pose
) -> FanGeometry:
    device = reading.device
    numbers = {}
    for name in ("range_min_m", "range_max_m", "azimuth_deg", "elevation_deg"):
        attribute = {"azimuth_deg": "azimuth_fov_deg", "elevation_deg": "elevation_fov_deg"}
        value = arrays.get(name)
        if value is None and device is None:
            raise RecordingError(
                f"{path}: no `{name}` in it; add it, or say which sonar it was (--sonar)"
            )
        if value is None:
            value = np.array(getattr(device, attribute.get(name, name)))
        if value.size != 1 or value.dtype.kind not in "iuf" or not np.isfinite(value).all():
            raise RecordingError(f"{path}: `{name}` is not one number")
        numbers[name] = float(value.reshape(()))
    near, far = numbers["range_min_m"], numbers["range_max_m"]
    azimuth, elevation = numbers["azimuth_deg"], numbers["elevation_deg"]
    if not (0.0 <= near < far < 1e5 and 0.0 < azimuth <= 180.0 and 0.0 < elevation <= 180.0):
        raise RecordingError(
            f"{path}: a fan of {azimuth:g} x {elevation:g} degrees from {near:g} to {far:g} m "
            "makes no sense; check range_min_m, range_max_m, azimuth_deg, elevation_deg"
        )
    return FanGeometry(
        azimuth_fov_rad=math.radians(azimuth),
        elevation_fov_rad=math.radians(elevation),
        beams=images.shape[2],
        bins=images.shape[1],
        range_min_m=near,
        range_max_m=far,
        mount=mount,
    )


def _starboard_first(path: Path, arrays: dict[str, Array]) -> bool:
    if "columns" not in arrays:
        return True
    told = str(arrays["columns"]).strip().lower().replace("-", "_").replace(" ", "_")
    if told not in ("port_to_starboard", "starboard_to_port"):
        raise RecordingError(
            f"{path}: `columns` is {str(arrays['columns'])!r:.60}; write port_to_starboard or "
            "starboard_to_port"
        )
    return told == "starboard_to_port"


def _mount(path: Path, arrays: dict[str, Array], reading: Reading) -> Pose:
    mount = arrays.get("mount")
    if mount is not None:
        return _pose_rows(path, "mount", mount.reshape(1, -1))[0]
    sensor = "pose_sensor" in arrays and reading.poses is None
    if not sensor and reading.device is not None:
        return reading.device.geometry.mount
    return Pose(0.0, 0.0, 0.0)


def _times(path: Path, arrays: dict[str, Array], count: int) -> Float64 | None:
    times = arrays.get("time_s")
    if times is None:
        return None
    if times.shape != (count,) or times.dtype.kind not in "iuf" or not np.isfinite(times).all():
        raise RecordingError(
            f"{path}: `time_s` of shape {times.shape} is not one time for each of {count} images"
        )
    return times.astype(np.float64)


def _poses(path: Path, arrays: dict[str, Array], count: int, mount: Pose) -> list[Pose] | None:
    body, sensor = arrays.get("pose_body"), arrays.get("pose_sensor")
    if body is not None and len(body) == count:
        return _pose_rows(path, "pose_body", body)
    if sensor is not None and sensor.shape == (count, 4, 4) and sensor.dtype.kind == "f":
        return _from_matrices(path, sensor.astype(np.float64), mount)
    if body is None and sensor is None:
        return None
    name, given = ("pose_body", body) if body is not None else ("pose_sensor", sensor)
    assert given is not None
    raise RecordingError(
        f"{path}: `{name}` of shape {given.shape} is not one pose for each of {count} images; "
        "pose_body is (pings, 6), pose_sensor (pings, 4, 4)"
    )


def _pose_rows(path: Path, name: str, rows: Array) -> list[Pose]:
    if rows.ndim != 2 or rows.shape[1] != 6 or rows.dtype.kind not in "iuf":
        raise RecordingError(f"{path}: `{name}` needs x, y, z, roll, pitch, yaw (m, rad) a row")
    if not np.isfinite(rows).all():
        raise RecordingError(f"{path}: `{name}` holds a number that is not finite")
    widest = float(np.abs(rows[:, 3:]).max(initial=0.0))
    if widest > 2 * math.pi + 1e-6:
        raise RecordingError(
            f"{path}: `{name}` has an angle of {widest:.6g}, more than a whole turn; angles are "
            "radians, so it is likely in degrees"
        )
    return [Pose(*map(float, row)) for row in rows]


def _from_matrices(path: Path, matrices: Float64, mount: Pose) -> list[Pose]:
    if np.abs(matrices[:, 3] - [0.0, 0.0, 0.0, 1.0]).max() > 1e-6:
        across = bool(np.abs(matrices[:, :, 3] - [0.0, 0.0, 0.0, 1.0]).max() <= 1e-6)
        raise RecordingError(
            f"{path}: the last row of `pose_sensor` is not 0 0 0 1"
            + ("; its matrices are transposed, so write pose_sensor.transpose(0, 2, 1)" * across)
        )
    turns = matrices[:, :3, :3]
    finite = np.isfinite(matrices).all()
    if not finite or np.abs(turns @ turns.transpose(0, 2, 1) - np.eye(3)).max() > 1e-3:
        raise RecordingError(f"{path}: `pose_sensor` holds a matrix that is not a rigid transform")
    if (np.linalg.det(turns) < 0).any():
        raise RecordingError(f"{path}: `pose_sensor` holds a mirrored (left-handed) frame")
    body_from_sensor = np.linalg.inv(transform_from_pose(mount))
    return [pose_from_transform(matrix @ body_from_sensor) for matrix in matrices]
