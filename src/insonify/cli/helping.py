"""How ``--help`` looks: options in panels, with their choices and defaults, and some examples."""

from __future__ import annotations

from typing import Any

from typer.core import TyperGroup

PANELS = {
    "What": "planner planners object_ seed seeds count pose path orbit "
    "waypoints from_ search materials settings config sql recording datum epsg split license",
    "Sonar": "sonar sonars range_m model renderer truth camera",
    "Mapping": "mapper voxel threshold region memory",
    "Recording": "poses beams convention mount full_scale clock_offset_s max_gap_s pose_topic "
    "sonar_topic rate wait idle",
    "Vehicle": "plan clearance speed radius vehicle current navigation real_time live_bus",
    "Output": "out force as_json live view foxglove mcap picture every quiet port host workers "
    "scheduler prune yes formats upload",
}
"""Options by the names of their parameters; others are in typer's own panel."""

CHOICES = {
    "renderer": "embree|opengl",
    "model": "cerqueira|physical",
    "navigation": "truth|dvl",
    "sonar": "NAME|FILE",
    "seed": "N",
    "seeds": "N",
    "count": "N",
    "waypoints": "N",
    "workers": "N",
    "port": "N",
    "host": "ADDRESS",
    "config": "FILE",
    "command": "COMMAND",
}
"""What an option takes, where it does not say so itself."""

DEFAULTS = {
    "scan": {
        "scenario": "tetrapod",
        "planner": "entropy",
        "mapper": "bayes",
        "sonar": "park-2025",
        "renderer": "embree",
        "model": "cerqueira",
        "seed": "0",
        "navigation": "dvl",
        "out": "insonify-runs/SCENARIO-PLANNER-seedN",
    },
    "simulate": {"renderer": "embree", "model": "cerqueira", "seed": "0"},
    "dataset": {"renderer": "embree", "model": "cerqueira", "seed": "0"},
    "fly": {"sonars": "flatfish", "vehicle": "bluerov2", "navigation": "dvl", "seed": "0"},
    "map": {"mapper": "bayes"},
    "live": {"mapper": "bayes", "out": "insonify-runs/live"},
}
"""What holds unless an option says otherwise; the settings have it, which are not yet loaded."""

EXAMPLES = {
    "scan": (
        "insonify scan tetrapod",
        "insonify scan wreck --mapper carving --planner rosette --seed 3",
        "insonify scan tetrapod --vehicle bluerov2 --navigation dvl --out dive",
        "insonify scan tetrapod --live-bus",
    ),
    "compare": (
        "insonify compare tetrapod wreck",
        "insonify compare tetrapod --planner rosette --mapper carving --seeds 5",
        "insonify compare tetrapod --all --json",
    ),
    "simulate": (
        "insonify simulate fls-tank",
        'insonify simulate structures --sonar gemini-720is --orbit "9 0 -16 8 8 25" --truth',
        "insonify simulate my.world --path track.csv --model physical --range 30",
    ),
    "fly": (
        'insonify fly tank --waypoints "0 0 -1 0; 1 0 -1 90"',
        'insonify fly structures --waypoints "2 0 -17 0; 6 0 -17 0" --navigation dvl',
        'insonify fly tank --waypoints "0 0 -1 0; 1 0 -1 0" --mcap --out dive',
    ),
    "dataset": (
        "insonify dataset structures --count 100",
        "insonify dataset my.world --sonar oculus-m750d-1200khz --model physical --count 1000",
        "insonify dataset field@0 field@1 field@2 field@3 --split 50/25/25 --format yolo",
    ),
    "map": (
        "insonify map dive.mcap --voxel 0.1 --out map",
        "insonify map sonar.aris --poses track.tum --voxel 0.05 --out map",
        "insonify map dive.mcap --mapper carving --voxel 0.1 --out map",
        "insonify map survey.mcap --memory 500MB --out survey",
    ),
    "live": (
        "insonify live --voxel 0.1 --out dive",
        'insonify live --plan --region "-5 -5 -20 5 5 -16" --out dive',
        "insonify live --from dive.mcap --rate 1 --voxel 0.1 --view",
    ),
    "play": ("insonify play dive.mcap", "insonify play sonar.aris --poses track.tum --rate 2"),
    "info": ("insonify info dive.mcap", "insonify info sonar.aris --picture ping.png"),
    "view": ("insonify view insonify-runs/tetrapod-entropy-seed0", "insonify view map.zarr"),
    "plan": (
        'insonify plan map --from "0 0 -15 90" --datum "41.5 -71.3" --out next',
        'insonify plan insonify-runs/mine --from "8 0 -14 180" --picture next.png',
    ),
    "runs": ("insonify runs", "insonify runs --prune"),
    "export": (
        "insonify export run map.bt",
        "insonify export run points.ply",
        "insonify export run dive.rrd",
    ),
}


class Commands(TyperGroup):
    """The commands, each with its help arranged when it is asked for."""

    def get_params(self, ctx: Any) -> Any:
        """The options that stand before any command."""
        params = super().get_params(ctx)
        for param in params:
            param.metavar = "" if getattr(param, "is_flag", False) else param.metavar
        return params

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """A command by its name."""
        command = super().get_command(ctx, cmd_name)
        if command is not None:
            _arrange(command, cmd_name, command.get_help_option(ctx))
        return command


def _arrange(command: Any, name: str, help_option: Any) -> None:
    if help_option is not None:
        help_option.metavar, help_option.rich_help_panel = "", "Output"
    panels = {option: panel for panel, options in PANELS.items() for option in options.split()}
    defaults = DEFAULTS.get(name, {})
    for param in command.params:
        if param.param_type_name == "option":
            param.rich_help_panel = panels.get(param.name)
        else:
            param.display_type_rich = _no_type  # its name says what it is
        if getattr(param, "is_flag", False):
            param.metavar = ""  # it takes nothing
        elif param.metavar is None:
            param.metavar = CHOICES.get(param.name)
        default = f" Default: {defaults[param.name]}." if param.name in defaults else ""
        if default and default not in param.help:
            param.help = f"{param.help.removesuffix('.')}.{default}"
    if name in EXAMPLES:
        command.epilog = "\n\n".join(("For example:", *EXAMPLES[name]))


def _no_type(*, ctx: Any) -> None:
    """What is shown of an argument's type."""
