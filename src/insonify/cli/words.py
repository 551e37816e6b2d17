"""What is in a recording, in the words and units of people."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

_UNITS = {
    "_hz": ((1e6, "MHz"), (1e3, "kHz"), (0.0, "Hz")),
    "_mps": ((0.0, "m/s"),),
    "_m": ((1.0, "m"), (1e-2, "cm"), (0.0, "mm")),
    "_deg_c": ((0.0, "degrees C"),),
    "_deg": ((0.0, "degrees"),),
    "_s": ((0.0, "s"),),
}
_SCALES = {"MHz": 1e6, "kHz": 1e3, "cm": 1e-2, "mm": 1e-3}
_EPOCH_S = 3e8
"""Clocks that say more count from 1970."""
_MANY = 12
"""So many parts of a fact are told one a line; of more, how many there are."""


def summary_rows(summary: dict[str, Any]) -> list[list[str]]:
    """Rows of a table for `insonify.io.recordings.summary.summarise`."""
    rows = [[key, str(summary[key])] for key in ("file", "format", "pings")]
    if summary["clock"]:
        rows += [
            ["first ping", _moment(summary["first_s"])],
            ["duration", f"{summary['duration_s']:.3f} s"],
        ]
    else:
        rows += [["clock", "none: pings count from 0"]]
    for fan in summary["fans"][:_MANY]:
        rows += _fan_rows(fan, alone=len(summary["fans"]) == 1)
    if len(summary["fans"]) > _MANY:
        rows.append(["more fans", str(len(summary["fans"]) - _MANY)])
    rows.append(["pixels, of 1", f"mean {summary['pixel_mean']}, most {summary['pixel_max']}"])
    path = f", {summary['path_m']:.3f} m of path" if summary["poses"] else ""
    rows.append(["poses", f"{summary['poses']} of {summary['pings']} pings{path}"])
    says = dict(summary["says"])
    doubts = says.pop("doubts", [])
    says["source of poses"] = says.pop("poses")
    for key, value in says.items():
        rows += _fact_rows(key, value)
    return [*rows, *(["assumed", doubt] for doubt in doubts)]


def pose_rows(summary: dict[str, Any]) -> list[list[str]]:
    """Rows of a table for `insonify.io.recordings.summary.summarise_poses`."""
    box = zip(("east", "north", "up"), summary["low_m"], summary["high_m"], strict=True)
    return [
        *([key, str(summary[key])] for key in ("file", "format", "poses")),
        ["first pose", _moment(summary["first_s"])],
        ["duration", f"{summary['duration_s']:.3f} s"],
        ["path", f"{summary['path_m']:.3f} m"],
        *([name, f"{low:g} to {high:g} m"] for name, low, high in box),
    ]


def plan_rows(document: dict[str, Any]) -> list[list[str]]:
    """Rows of a table for what ``plan`` tells."""
    low, high = document["region_m"]
    rows = [["vehicle", _pose(document["from"])], ["region", f"{_point(low)} to {_point(high)}"]]
    if "cluster_voxels" in document:
        settled = f"{100.0 * document['best_share']:.3g} % of it"
        rows += [
            ["largest undecided cluster",
             f"{document['cluster_voxels']:,} voxels, "
             f"{document['cluster_entropy_bits']:,.0f} bits, "
             f"around {_point(document['cluster_centre_m'])}"],
            [f"best of {document['candidates']} poses", f"would settle {settled}"],
        ]  # fmt: skip
    if "start" in document:
        rows += [
            ["scan begins at", _pose(document["start"])],
            ["scan", f"{document['length_m']:.3g} m, {document['pings']} pings"],
            ["way there", f"{document['transit_m']:.3g} m"
             f"{', round what is mapped' if document['detour'] else ''}"],
            ["speed", f"{document['speed_mps']:g} m/s"],
            ["least clearance", f"{document['clearance_m']:.3g} m"],
            ["files", ", ".join(document["files"])],
            *([["sent to", document["uploaded_to"]]] if "uploaded_to" in document else []),
        ]  # fmt: skip
    if document["stop"] is not None:
        rows.append(["nothing to scan", document["stop"]])
    return rows


def _point(place_m: list[float]) -> str:
    return f"({', '.join(f'{c:.4g}' for c in place_m)}) m"


def _pose(pose: list[float]) -> str:
    """Place and yaw, counted from east to north, with the compass heading."""
    *place_m, yaw_deg = pose
    heading = (90.0 - yaw_deg) % 360.0
    return f"{_point(place_m)}, yaw {yaw_deg:.4g} degrees (compass {heading:.0f})"


def _moment(time_s: float) -> str:
    """A time of a clock; of one that counts from 1970, as a date."""
    if not _EPOCH_S < time_s < 4e9:
        return f"{time_s:.3f} s"
    return f"{datetime.fromtimestamp(time_s, UTC):%Y-%m-%d %H:%M:%S.%f}"[:-3] + " UTC"


def _fan_rows(fan: dict[str, Any], *, alone: bool) -> list[list[str]]:
    low, high = fan["bearings_deg"]
    return [
        ["fan" if alone else f"fan of {fan['pings']} pings",
         f"{fan['beams']} beams x {fan['bins']} bins"],
        ["  ranges", f"{fan['range_min_m']:.6g} to {fan['range_max_m']:.6g} m"],
        ["  bin", quantity("bin_m", fan["bin_m"])[1]],
        ["  azimuth", f"{_side(low)} to {_side(high)}"],
        ["  elevation", f"{fan['elevation_deg']:g} degrees in all"],
        ["  mount", _place(fan["mount_m"])],
        ["  mount's roll, pitch, yaw", _turns(fan)],
    ]  # fmt: skip


def _side(bearing_deg: float) -> str:
    if abs(bearing_deg) < 0.005:
        return "ahead"
    return f"{abs(bearing_deg):.2f} degrees to {'starboard' if bearing_deg > 0.0 else 'port'}"


def _place(mount_m: list[float]) -> str:
    x, y, z = mount_m
    return f"{x:g} m forward, {y:g} m to port, {z:g} m up"


def _turns(fan: dict[str, Any]) -> str:
    if "mount_turns_deg" in fan:
        told = (f"{low + 0.0:g}" if low == high else f"{low:g} to {high:g}"
                for low, high in fan["mount_turns_deg"])  # fmt: skip
        return f"{', '.join(told)} degrees: it turns from ping to ping"
    roll, pitch, yaw = (angle + 0.0 for angle in fan["mount_rpy_deg"])
    return f"{roll:g}, {pitch:g} ({_tilt(pitch)}), {yaw:g} degrees"


def _tilt(pitch_deg: float) -> str:
    return "level" if pitch_deg == 0.0 else "looks down" if pitch_deg > 0.0 else "looks up"


def _fact_rows(key: str, value: Any) -> list[list[str]]:
    if value is None or value == "" or value == []:
        return []
    if isinstance(value, dict):
        parts = [["", f"{name}: {quantity(name, part)[1]}"] for name, part in value.items()]
        parts[0][0] = key.replace("_", " ")
        return parts
    return [list(quantity(key, value))]


def quantity(key: str, value: Any) -> tuple[str, str]:
    """A figure with a unit in its name, as a name and a value for people.

    Two numbers are the least and the greatest of what changes.
    """
    if isinstance(value, bool):
        return key.replace("_", " "), "yes" if value else "no"
    ending = next((one for one in _UNITS if key.endswith(one)), "")
    name = key.removesuffix(ending).replace("_", " ")
    numbers = value if isinstance(value, list | tuple) else [value]
    if not all(isinstance(number, int | float) for number in numbers):
        return name, ", ".join(map(str, numbers))
    most = max(abs(number) for number in numbers)
    unit = next((word for least, word in _UNITS.get(ending, ()) if most >= least), "")
    if most == 0.0 and ending == "_m":
        unit = "m"
    told = " to ".join(f"{number / _SCALES.get(unit, 1.0):.6g}" for number in numbers)
    return name, f"{told} {unit}".rstrip()
