"""What ``--help`` shows: panels that fit, true defaults, examples that can be typed."""

from __future__ import annotations

import shlex
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from insonify.cli import app
from insonify.cli.helping import CHOICES, DEFAULTS, EXAMPLES, PANELS
from insonify.imaging.dataset import dataset_config
from insonify.imaging.route import simulation_config
from insonify.imaging.tour import tour_config
from insonify.mission.setup import scenario_config

GROUP: Any = typer.main.get_command(app)


@pytest.mark.parametrize("columns", [60, 80])
@pytest.mark.parametrize("command", [(), *((name,) for name in GROUP.commands)])
def test_help_fits_and_says_no_types(command: tuple[str, ...], columns: int) -> None:
    shown = CliRunner().invoke(app, [*command, "--help"], env={"COLUMNS": str(columns)})
    assert shown.exit_code == 0
    for line in shown.stdout.splitlines():
        assert len(line) <= columns
    for mark in ("<bool>", "<str>", "<int", "<path>", "[]"):
        assert mark not in shown.stdout, mark


def test_every_option_has_its_panel() -> None:
    known = {name for names in PANELS.values() for name in names.split()}
    asked = {
        param.name
        for command in GROUP.commands.values()
        for param in command.params
        if param.param_type_name == "option"
    }
    assert asked - known <= {"command", "schema"}
    assert known | set(CHOICES) <= asked


def test_defaults_are_those_of_the_settings() -> None:
    scan = scenario_config("tetrapod")
    assert scan.scenario == DEFAULTS["scan"]["scenario"]
    made: dict[str, Any] = {
        "scan": scan,
        "simulate": simulation_config("fls-tank", []),
        "dataset": dataset_config("structures", []),
        "fly": tour_config([{"world": "tank", "waypoints": [[0, 0, -1, 0], [1, 0, -1, 0]]}]),
    }
    for name, config in made.items():
        for option in {"planner", "mapper", "renderer", "model", "seed"} & set(DEFAULTS[name]):
            assert str(getattr(config, option)) == DEFAULTS[name][option], (name, option)
    assert scan.sonar.name == DEFAULTS["scan"]["sonar"]
    assert made["fly"].vehicle.name == DEFAULTS["fly"]["vehicle"]
    assert scan.vehicle.navigation == DEFAULTS["scan"]["navigation"]


@pytest.mark.parametrize("line", [line for lines in EXAMPLES.values() for line in lines])
def test_examples_can_be_typed(line: str) -> None:
    program, name, *words = shlex.split(line)
    assert program == "insonify"
    GROUP.commands[name].make_context(name, words)
