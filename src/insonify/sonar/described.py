"""Sonars that a simulated world describes, as devices: SDF sensors and Stonefish scenarios.

- SDF: a camera or ray sensor with a sonar's plugin (those of NPS and DAVE): field of view, beams,
  ranges; the plugin's own figures go before the camera's.  Bins follow from the bandwidth.
- Stonefish (``.scn``): sensors ``fls`` and ``msis``, as its documentation gives them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import count
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from insonify.errors import WorldError
from insonify.frames import FLU_FROM_FRD, pose_from_transform, transform_from_pose
from insonify.limits import MOST_INCLUDE_DEPTH, MOST_INCLUDES
from insonify.scene.sdf import SearchPath, model_file, parse_sdf, pose_of
from insonify.scene.xml import parse_xml
from insonify.types import Float64, Pose

_BINS = 500
"""Where nothing tells the resolution."""
_OPTICAL_FROM_SONAR = np.array(
    [[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
"""Stonefish's sensors look along z, x to starboard, y down."""


def described_sonars(path: Path) -> list[dict[str, Any]]:
    """Tables of device settings of the imaging sonars in a world, a model or a scenario.

    Raises:
        WorldError: The file cannot be read, describes none, or a figure is none.
    """
    if path.is_dir():
        path = model_file(path)
    if path.suffix == ".scn":
        found = list(_of_scenario(parse_xml(path, WorldError), path))
    else:
        found = list(_with_included(path.resolve(), (), count(1)))
    if not found:
        raise WorldError(f"{path}: no sensor in it is described as an imaging sonar")
    return found


def described_sonar(name: str) -> dict[str, Any]:
    """The settings of the sonar that ``FILE`` or ``FILE#SENSOR`` names.

    Raises:
        WorldError: There is none, or several and it is not said which.
    """
    file, _, wanted = name.partition("#")
    found = described_sonars(Path(file))
    names = ", ".join(table["name"] for table in found)
    if wanted:
        found = [table for table in found if table["name"] == wanted]
        if not found:
            raise WorldError(f"{file}: no sonar named {wanted!r}; its sonars: {names}")
    if len(found) > 1:
        raise WorldError(f"{file}: several sonars; say which, as {file}#NAME: {names}")
    return found[0]


def _with_included(
    path: Path, trail: tuple[Path, ...], files: Iterator[int]
) -> Iterator[dict[str, Any]]:
    """The sonars of an SDF file and of the models it includes, as far as they are there."""
    if next(files) > MOST_INCLUDES or len(trail) > MOST_INCLUDE_DEPTH:
        raise WorldError(
            f"{(*trail, path)[0]}: it includes more than {MOST_INCLUDES:,} models, or more than "
            f"{MOST_INCLUDE_DEPTH} deep"
        )
    root = parse_sdf(path)
    yield from _of_sdf(root, path)
    search = SearchPath.around(path)
    for include in root.iter("include"):
        found = search.find((include.findtext("uri") or "").strip(), path)
        model = None if found is None else model_file(found).resolve()
        if model is not None and model not in (*trail, path):
            yield from _with_included(model, (*trail, path), files)


def _of_sdf(root: ET.Element, path: Path) -> Iterator[dict[str, Any]]:
    for link in root.iter("link"):
        for sensor in link.iter("sensor"):
            name = sensor.get("name", "sonar")
            where = f"{path} (sensor {name!r})"
            plugin = next((one for one in sensor.iter("plugin") if _is_sonar(one)), None)
            kind = " ".join(sensor.attrib.values()).lower()
            if plugin is None and "sonar" not in kind.replace(name.lower(), ""):
                continue
            seen = _Figures(plugin, where)
            camera = sensor.find("camera")
            rays = next((r for tag in ("ray", "lidar") for r in sensor.iter(tag)), None)
            if camera is not None:
                table = _of_camera(_Figures(camera, where), seen)
            elif rays is not None:
                table = _of_rays(_Figures(rays, where))
            else:
                continue
            rate_hz = _Figures(sensor, where).number("update_rate")
            frequency_hz = seen.number("sonarFreq")
            table |= {"name": name}
            table |= _mounted(pose_of(link, where)[0] @ pose_of(sensor, where)[0])
            table |= {} if rate_hz is None else {"rate_hz": rate_hz}
            table |= {} if frequency_hz is None else {"frequency_khz": frequency_hz / 1e3}
            yield table


def _is_sonar(plugin: ET.Element) -> bool:
    return "sonar" in f"{plugin.get('filename', '')} {plugin.get('name', '')}".lower()


class _Figures:
    """Numbers in the children of an element, by their path."""

    def __init__(self, element: ET.Element | None, where: str) -> None:
        self._element, self._where = element, where

    def number(self, path: str) -> float | None:
        found = None if self._element is None else self._element.findtext(path)
        if found is None:
            return None
        return _finite(found, path, self._where)

    def needed(self, path: str) -> float:
        value = self.number(path)
        if value is None:
            raise WorldError(f"{self._where}: it has no <{path}>, so it is no sonar that is known")
        return value


def _finite(text: str, name: str, where: str) -> float:
    """A number of a file.

    Raises:
        WorldError: It is none.
    """
    try:
        value = float(text)
    except ValueError as err:
        raise WorldError(f"{where}: {name} is {text.strip()!r:.60}, not a number") from err
    if not math.isfinite(value):
        raise WorldError(f"{where}: {name} is {value}, not a finite number")
    return value


def _of_camera(camera: _Figures, plugin: _Figures) -> dict[str, Any]:
    across = camera.needed("horizontal_fov")
    width, height = camera.needed("image/width"), camera.number("image/height")
    high = plugin.number("verticalFOV")
    if high is None and height is not None:
        high = math.degrees(2.0 * math.atan(math.tan(across / 2.0) * height / width))
    near, far = camera.number("clip/near"), camera.number("clip/far")
    far = plugin.number("maxDistance") or far
    if high is None or far is None:
        raise WorldError("a camera without height or far plane is no sonar that is known")
    near = near or 0.0
    bandwidth_hz, speed_mps = plugin.number("bandwidth"), plugin.number("soundSpeed") or 1500.0
    bin_m = speed_mps / (2.0 * bandwidth_hz) if bandwidth_hz else (far - near) / _BINS
    return {
        "azimuth_fov_deg": round(math.degrees(across), 6),
        "elevation_fov_deg": high,
        "beams": round(width),
        "bins": max(1, round((far - near) / bin_m)),
        "range_min_m": near,
        "range_max_m": far,
    }


def _of_rays(rays: _Figures) -> dict[str, Any]:
    across = rays.needed("scan/horizontal/max_angle") - rays.needed("scan/horizontal/min_angle")
    high = rays.needed("scan/vertical/max_angle") - rays.needed("scan/vertical/min_angle")
    near, far = rays.needed("range/min"), rays.needed("range/max")
    step = rays.number("range/resolution")
    return {
        "azimuth_fov_deg": round(math.degrees(across), 6),
        "elevation_fov_deg": round(math.degrees(high), 6),
        "beams": round(rays.needed("scan/horizontal/samples")),
        "bins": max(1, round((far - near) / step)) if step else _BINS,
        "range_min_m": near,
        "range_max_m": far,
    }


def _mounted(transform: Float64) -> dict[str, Any]:
    pose = pose_from_transform(transform)
    roll, pitch, yaw = (
        round(math.degrees(angle), 6) + 0.0
        for angle in (pose.roll_rad, pose.pitch_rad, pose.yaw_rad)
    )
    place = [round(c, 6) + 0.0 for c in pose.position_m]
    return {"mount_m": place, "roll_deg": roll, "tilt_deg": pitch, "yaw_deg": yaw}


def _of_scenario(root: ET.Element, path: Path) -> Iterator[dict[str, Any]]:
    for sensor in root.iter("sensor"):
        kind, name = sensor.get("type", "").lower(), sensor.get("name", "sonar")
        if kind not in {"fls", "msis"}:
            continue
        where = f"{path} (sensor {name!r})"
        own = {
            key: value
            for part in ("specs", "settings")
            for found in sensor.findall(part)
            for key, value in found.attrib.items()
        }

        def number(key: str, own: dict[str, str] = own, where: str = where) -> float:
            if key not in own:
                raise WorldError(f"{where}: it lacks {key}, so it is no sonar that is known")
            return _finite(own[key], key, where)

        table: dict[str, Any] = {
            "name": name,
            "bins": round(number("bins")),
            "range_min_m": number("range_min"),
            "range_max_m": number("range_max"),
        } | _mounted(_seat(sensor, where))
        if kind == "fls":
            yield table | {
                "beams": round(number("beams")),
                "azimuth_fov_deg": number("horizontal_fov"),
                "elevation_fov_deg": number("vertical_fov"),
            }
        else:
            yield table | {
                "kind": "scanning",
                "beams": 1,
                "azimuth_fov_deg": number("horizontal_beam_width"),
                "elevation_fov_deg": number("vertical_beam_width"),
                "step_deg": number("step"),
                "sector_deg": min(360.0, number("rotation_max") - number("rotation_min")),
            }


def _seat(sensor: ET.Element, where: str) -> Float64:
    """Where a Stonefish sensor sits on its link, whose axes are forward, starboard, down."""
    origin = sensor.find("origin")
    told = {"xyz": "0 0 0", "rpy": "0 0 0"} | ({} if origin is None else dict(origin.attrib))
    numbers = [_finite(word, key, where) for key in ("xyz", "rpy") for word in told[key].split()]
    if len(numbers) != 6:
        raise WorldError(f"{where}: its origin is not of three and three numbers")
    place: Float64 = FLU_FROM_FRD @ transform_from_pose(Pose(*numbers)) @ _OPTICAL_FROM_SONAR
    return place
