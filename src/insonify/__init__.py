"""insonify: simulate imaging sonar, map with it, and decide where to scan next."""

from __future__ import annotations

import warnings
from importlib import import_module
from typing import TYPE_CHECKING, Any

from insonify import display

__version__ = "0.1.0"

if TYPE_CHECKING:
    from insonify.errors import InsonifyError as InsonifyError
    from insonify.io.maps import load_map as load_map
    from insonify.io.maps import save_map as save_map
    from insonify.io.pings import load_ping as load_ping
    from insonify.io.recordings import load_pings as load_pings
    from insonify.io.recordings import open_recording as open_recording
    from insonify.mapping.bayes import BayesMapper as BayesMapper
    from insonify.mapping.mapper import Belief as Belief
    from insonify.mapping.mapper import Mapper as Mapper
    from insonify.mapping.voxels import VoxelMap as VoxelMap
    from insonify.mission.remap import map_recordings as map_recordings
    from insonify.mission.run import execute as execute
    from insonify.mission.setup import World as World
    from insonify.mission.setup import scenario_config as scenario_config
    from insonify.planning.decision import Decision as Decision
    from insonify.planning.decision import Planner as Planner
    from insonify.results.campaign import load_campaign as load_campaign
    from insonify.results.files import load_result as load_result
    from insonify.results.scan import load_run as load_run
    from insonify.results.scan import save_scan as save_scan
    from insonify.scene import Scene as Scene
    from insonify.scene.worlds import load_scene as load_scene
    from insonify.sonar import Sonar as Sonar
    from insonify.types import Pose as Pose
    from insonify.types import StopReason as StopReason

_HOMES = {
    "BayesMapper": "insonify.mapping.bayes",
    "Belief": "insonify.mapping.mapper",
    "Decision": "insonify.planning.decision",
    "InsonifyError": "insonify.errors",
    "Mapper": "insonify.mapping.mapper",
    "Planner": "insonify.planning.decision",
    "Pose": "insonify.types",
    "Scene": "insonify.scene",
    "Sonar": "insonify.sonar",
    "StopReason": "insonify.types",
    "VoxelMap": "insonify.mapping.voxels",
    "World": "insonify.mission.setup",
    "execute": "insonify.mission.run",
    "load_campaign": "insonify.results.campaign",
    "load_map": "insonify.io.maps",
    "load_ping": "insonify.io.pings",
    "load_pings": "insonify.io.recordings",
    "load_result": "insonify.results.files",
    "load_run": "insonify.results.scan",
    "load_scene": "insonify.scene.worlds",
    "map_recordings": "insonify.mission.remap",
    "open_recording": "insonify.io.recordings",
    "save_map": "insonify.io.maps",
    "save_scan": "insonify.results.scan",
    "scenario_config": "insonify.mission.setup",
}

_FORMER = {"load_scan": "load_run"}
"""Names that go with the next minor version, and what they are called now."""

__all__ = sorted([*_HOMES, "__version__"])

display.drawn_by(lambda: import_module("insonify.report.showing"))


def __getattr__(name: str) -> Any:
    """Import a public name when it is first asked for, so that the command line starts fast."""
    if name in _FORMER:
        warnings.warn(
            f"insonify.{name} is called {_FORMER[name]} now", DeprecationWarning, stacklevel=2
        )
        name = _FORMER[name]
    if name not in _HOMES:
        raise AttributeError(f"module 'insonify' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
