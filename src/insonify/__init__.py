"""insonify: simulate imaging sonar, map with it, and decide where to scan next."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from insonify.errors import InsonifyError as InsonifyError
    from insonify.io.maps import load_map as load_map
    from insonify.io.maps import save_map as save_map
    from insonify.io.recordings import open_recording as open_recording
    from insonify.mapping.bayes import BayesMapper as BayesMapper
    from insonify.mapping.voxels import VoxelMap as VoxelMap
    from insonify.planning.decision import Decision as Decision
    from insonify.planning.decision import Planner as Planner
    from insonify.planning.decision import StopReason as StopReason
    from insonify.replay import map_recordings as map_recordings
    from insonify.runs import execute as execute
    from insonify.scenarios import World as World
    from insonify.scenarios import scenario_config as scenario_config
    from insonify.scene import Scene as Scene
    from insonify.scene.worlds import load_scene as load_scene
    from insonify.sonar import Sonar as Sonar
    from insonify.types import Pose as Pose

_HOMES = {
    "BayesMapper": "insonify.mapping.bayes",
    "Decision": "insonify.planning.decision",
    "InsonifyError": "insonify.errors",
    "Planner": "insonify.planning.decision",
    "Pose": "insonify.types",
    "Scene": "insonify.scene",
    "Sonar": "insonify.sonar",
    "StopReason": "insonify.planning.decision",
    "VoxelMap": "insonify.mapping.voxels",
    "World": "insonify.scenarios",
    "execute": "insonify.runs",
    "load_scene": "insonify.scene.worlds",
    "load_map": "insonify.io.maps",
    "map_recordings": "insonify.replay",
    "open_recording": "insonify.io.recordings",
    "save_map": "insonify.io.maps",
    "scenario_config": "insonify.scenarios",
}

__all__ = sorted([*_HOMES, "__version__"])


def __getattr__(name: str) -> Any:
    """Import a public name when it is first asked for, so that the command line starts fast."""
    if name not in _HOMES:
        raise AttributeError(f"module 'insonify' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
