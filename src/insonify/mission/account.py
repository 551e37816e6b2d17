"""What a scan leaves for those who look at it: reports and views, of a run or of its files."""

from __future__ import annotations

from dataclasses import dataclass

from insonify.display import Told
from insonify.evaluation import GroundTruth, Solid
from insonify.mapping.voxels import VoxelMap
from insonify.mission.result import ScanResult
from insonify.planning.decision import DecisionRecord
from insonify.types import Box, PosedPing, ScanPath
from insonify.vehicle.craft import Moment


@dataclass(frozen=True, slots=True, eq=False)
class Account(Told):
    """All there is to show of a scan.

    Attributes:
        result: Its figures.
        config_toml: What it ran on, as text.
        region: The designated area.
        voxels: The map at its end.
        truth: Ground-truth voxels.
        solids: The true world.
        decisions: What the planner answered, in order.
        paths: The scans flown; the last is cut short if the run was interrupted.
        keyframes: Some pings of each scan, with its number.
        moments: The vehicle's track, if there was a vehicle.
    """

    result: ScanResult
    config_toml: str
    region: Box
    voxels: VoxelMap
    truth: GroundTruth
    solids: tuple[Solid, ...]
    decisions: tuple[DecisionRecord, ...]
    paths: tuple[ScanPath, ...]
    keyframes: tuple[tuple[int, PosedPing], ...] = ()
    moments: tuple[Moment, ...] = ()
