"""What a reader asks of a scan first, in words: what, with which sonar, how, and why it ended."""

from __future__ import annotations

import tomllib

from insonify.config.settings import Table
from insonify.mission.account import Account
from insonify.mission.result import ScanResult
from insonify.planning.decision import Decision

_NAVIGATION = {"truth": "knowing its true pose", "dvl": "by IMU, Doppler log, depth and compass"}


def lead(account: Account) -> str:
    """One sentence under the title."""
    settings, result = tomllib.loads(account.config_toml), account.result
    sonar, survey = settings.get("sonar", {}), settings.get("survey", {})
    text = "Scanned"
    if sonar.get("name"):
        text += f" with the sonar {sonar['name']}"
    if "altitude_m" in survey:
        text += f" from {survey['altitude_m']:g} m above the seabed"
    return f"{text}, led by the {result.planner} planner, seed {result.seed}"


def facts(account: Account) -> list[tuple[str, str]]:
    """Questions and answers; what a config of another version does not tell is left out."""
    settings, result = tomllib.loads(account.config_toml), account.result
    told = [
        ("What", _what(settings, account)),
        ("Sonar", _sonar(settings)),
        ("Altitude", _altitude(settings)),
        ("Carried by", _carrier(settings, result)),
        ("Planner", f"{result.planner}: {result.scans} scans were flown"),
        ("Map", _map(account)),
        ("Why it stopped", why(account)),
        ("Made with", f"insonify {result.insonify}, seed {result.seed}"),
    ]
    return [(question, answer) for question, answer in told if answer]


def why(account: Account) -> str:
    """Why the scan ended, with the numbers that were compared."""
    told, reason = account.result.why_stopped, account.result.stop_reason
    last = account.decisions[-1].decision if account.decisions else None
    if told is None and last is not None and last.stop is reason:  # older files do not tell
        told = last.why_not
    return told or reason.sentence


def offer(decision: Decision) -> str:
    """What the best candidate would show, and what is needed; nothing without candidates."""
    look = decision.look
    if look is None:
        return ""
    share = look.h_cluster[look.best] / look.cluster.entropy
    return (
        f"The best of {len(look.candidates)} candidates would show {100 * share:.1f} % of the "
        f"largest cluster's entropy; a scan is flown for more than {100 * look.termination:g} %."
    )


def _what(settings: Table, account: Account) -> str:
    size = " x ".join(f"{side:.1f}" for side in account.region.size_m)
    mesh = settings.get("object", {}).get("mesh")
    name = account.result.scenario
    of = f" ({mesh})" if mesh and mesh != name and not settings.get("objects") else ""
    return f"{name}{of}; the designated area around it is {size} m"


def _sonar(settings: Table) -> str:
    sonar = settings.get("sonar", {})
    try:
        return (
            f"{sonar['name']}: {sonar['azimuth_fov_deg']:g}° across, "
            f"{sonar['elevation_fov_deg']:g}° high, {sonar['beams']} beams of {sonar['bins']} "
            f"bins, {sonar['range_min_m']:g} to {sonar['range_max_m']:g} m, tilted "
            f"{sonar['tilt_deg']:g}° down; image model {settings['model']}, renderer "
            f"{settings['renderer']}"
        )
    except KeyError:
        return str(sonar.get("name", ""))


def _altitude(settings: Table) -> str:
    survey = settings.get("survey", {})
    if not {"altitude_m", "clearance_m"} <= survey.keys():
        return ""
    return (
        f"ordered {survey['altitude_m']:g} m above the mean seabed, and at least "
        f"{survey['clearance_m']:g} m from anything"
    )


def _carrier(settings: Table, result: ScanResult) -> str:
    if result.vehicle is not None:
        by = _NAVIGATION.get(result.vehicle.navigation, result.vehicle.navigation)
        return f"{result.vehicle.name}, navigating {by}, {result.vehicle.time_s:.0f} s under way"
    noise = settings.get("vehicle", {}).get("pose_noise", {})
    if any(noise.values()):
        return "no vehicle: poses as planned, believed with errors (vehicle.pose_noise)"
    return "no vehicle: every pose is taken exactly as planned"


def _map(account: Account) -> str:
    return f"mapper {account.result.mapper}, voxels of {account.voxels.voxel_m:g} m"
