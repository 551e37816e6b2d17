"""What a session leaves: what `map` leaves, the pings as they were mapped, and an account of it."""

from __future__ import annotations

import json
from pathlib import Path

from insonify.live.keeping import RECORDINGS, Keeper
from insonify.live.session import Session
from insonify.mission.remap import settle_region
from insonify.mission.result import MapResult
from insonify.results.map import MapConfig, save_remap
from insonify.types import Box

ACCOUNT = "live.json"


def save_session(
    session: Session,
    keeper: Keeper,
    folder: Path,
    target: Path,
    config: MapConfig,
    region: Box | None,
) -> MapResult | None:
    """Write a session that has ended into a folder that exists.

    Args:
        session: The session.
        keeper: Its recordings.
        folder: Where to.
        target: Where the folder will be, for the places of the recordings.
        config: How pings were mapped.
        region: Where entropy is counted; by default around what is occupied.

    Returns:
        Its figures; None if no ping was mapped, so that there is no map.
    """
    told = {"poses_from": session.poser.source, **session.counts.to_json()}
    told |= {"plans": session.plans_told()} if session.plans else {}
    (folder / ACCOUNT).write_text(json.dumps(told, indent=2) + "\n", encoding="utf-8")
    remap = session.remap
    if not remap.poses:
        return None
    settle_region(remap, region)
    remap.sources = [
        {
            "file": str(target / RECORDINGS / part["name"]),
            "format": "MCAP (ROS 2)",
            "pings": part["pings"],
            "mapped": part["mapped"],
            "doubts": session.poser.doubts,
        }
        for part in keeper.parts
    ]
    return save_remap(remap, folder, config)
