"""The way to a scan round what is mapped, never nearer to it than a clearance."""

from __future__ import annotations

from dataclasses import dataclass

from insonify.mapping.voxels import VoxelMap
from insonify.planning.once import clearance_m, half_diagonal_m, turns_of
from insonify.types import Pose, ScanPath
from insonify.vehicle.autopilot.routing import clear_route, obstacles_near


@dataclass(frozen=True, slots=True)
class Lead:
    """How a vehicle gets to a scan, or why it does not.

    Attributes:
        way: The poses to the scan's first one, which is the last of them; None if there is no way.
        near_m: How near the vehicle, the way and the scan come to what is mapped; where there is no
            way, what was too near, or 0 if all ways round are shut.
        why: What is wrong, if anything is.
    """

    way: tuple[Pose, ...] | None
    near_m: float
    why: str = ""


def lead_to(voxels: VoxelMap, pose: Pose, path: ScanPath, least_m: float) -> Lead:
    """Lead a vehicle to a scan: straight if that keeps clear, else round what is mapped.

    Ways round lie at the scan's height.  Of what the map does not know, nothing is known.

    Args:
        voxels: The map.
        pose: Where the vehicle is.
        path: The scan.
        least_m: The clearance: least distance to the surface of an occupied voxel.
    """
    start, ends = path.waypoints[0], turns_of(path.waypoints)
    scan_m = clearance_m(voxels, ends)
    here_m = clearance_m(voxels, (pose,))
    if min(scan_m, here_m) < least_m:
        what = "the scan comes" if scan_m < least_m else "the vehicle is"
        near_m = min(scan_m, here_m)
        return Lead(
            None,
            near_m,
            f"{what} within {near_m:.2f} m of an occupied voxel, and {least_m:g} m is the least",
        )
    way: tuple[Pose, ...] | None = (start,)
    near_m = clearance_m(voxels, (pose, start))
    if near_m < least_m:
        far_m = least_m + half_diagonal_m(voxels)
        way = clear_route(pose, (start,), obstacles_near(voxels, (pose, start), far_m), far_m)
        near_m = 0.0 if way is None else clearance_m(voxels, (pose, *way))
    if way is None or near_m < least_m:
        why = f"no way to the scan keeps {least_m:g} m from what is mapped at the vehicle's height"
        return Lead(None, 0.0, why)
    return Lead(way, min(near_m, scan_m))
