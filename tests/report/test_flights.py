from __future__ import annotations

import re
from pathlib import Path

import pytest

from insonify.mission.run import execute
from insonify.mission.setup import scenario_config
from insonify.report.html import write_report

pytestmark = pytest.mark.slow

SMALL = {"mapping": {"voxel_m": 0.25}, "survey": {"approach_m": 2.0, "baseline_scans": 1}}
FLOWN = {"planner": "uniform", "vehicle": {"name": "bluerov2", "ping_hz": 1.0}}


def test_a_flown_report_shows_tracks_errors_and_what_they_cost(tmp_path: Path) -> None:
    run = execute(scenario_config("tetrapod", [SMALL, FLOWN]))
    write_report(run.account(), tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    section = page[page.index('<section id="flight">') : page.index('<section id="map">')]
    assert len(re.findall(r'<img alt="[^"]+" src="data:image/png', section)) == 2 + 6
    result = run.result().to_json()
    perfect = result["vehicle"]["metrics_at_true_poses"]["solid"]["exact"]["f1"]
    own = result["metrics"]["solid"]["exact"]["f1"]
    assert f"<td>{own:.3f}</td><td>{perfect:.3f}</td><td>{own - perfect:+.3f}</td>" in section
    assert f"{result['vehicle']['pose_error']['position_max_m']:.3f}" in section


def test_without_a_vehicle_there_is_no_flight(tmp_path: Path) -> None:
    run = execute(scenario_config("tetrapod", [SMALL, {"planner": "uniform"}]))
    write_report(run.account(), tmp_path / "report.html")
    assert '<section id="flight">' not in (tmp_path / "report.html").read_text(encoding="utf-8")
