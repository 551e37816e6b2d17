from __future__ import annotations

import fcntl
import math
from pathlib import Path
from typing import Any

import pytest

import insonify
from insonify.config.settings import validated
from insonify.errors import ConfigError, OutputError, ResultError
from insonify.mission.campaign import CampaignSettings
from insonify.mission.result import CampaignResult
from insonify.results.campaign import load_campaign, query, run_campaign
from insonify.results.files import load_result

pytestmark = pytest.mark.slow

SMALL = {
    "mapping": {"voxel_m": 0.25},
    "survey": {"waypoints": 6, "baseline_scans": 2},
}


def _settings(**told: Any) -> CampaignSettings:
    table = {"scenarios": ["tetrapod"], "planners": ["uniform"], "seeds": 1, "set": SMALL, **told}
    return validated(CampaignSettings, table)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    run_campaign(_settings(), tmp_path / "c")
    return tmp_path / "c"


def test_tables_hold_what_the_run_was(folder: Path) -> None:
    campaign = insonify.load_campaign(folder)
    (run,) = campaign.runs.to_dict("records")
    assert (run["planner"], run["seed"], run["scans"], run["pings"]) == ("uniform", 0, 2, 12)
    assert run["stop_reason"] == "plan_flown" and math.isnan(run["time_s"])
    moments = campaign.curves.to_dict("records")
    assert [row["scan"] for row in moments] == [1, 2]
    assert moments[-1]["solid_exact_f1"] == run["solid_exact_f1"] > moments[0]["solid_exact_f1"]
    assert (folder / "parts" / f"{run['run']}.parquet").is_file()
    assert campaign.seconds["sonar"][0] > 0.0 and campaign.failed == ()
    result = load_result(folder)
    assert isinstance(result, CampaignResult) and (result.runs, result.planned) == (1, 1)


def test_what_is_added_is_flown_and_what_was_flown_is_not(folder: Path) -> None:
    (part,) = (folder / "parts").iterdir()
    before = part.stat().st_mtime_ns
    told: list[tuple[int, int, int]] = []
    run_campaign(_settings(seeds=[2, 0]), folder, watch=lambda *counts: told.append(counts))
    assert told == [(0, 0, 2), (1, 0, 2), (2, 0, 2)]
    assert part.stat().st_mtime_ns == before
    assert list(load_campaign(folder).runs["seed"]) == [2, 0]
    assert len(list((folder / "parts").iterdir())) == 2
    # what is no longer asked for is not in the tables, and not lost
    run_campaign(_settings(seeds=[2]), folder)
    assert list(load_campaign(folder).runs["seed"]) == [2]
    assert part.is_file()


def test_a_vehicle_adds_its_time_and_errors(tmp_path: Path) -> None:
    settings = _settings(
        navigation=["none", "dvl"],
        set=SMALL | {"vehicle": {"name": "bluerov2"}},
        set_for={"uniform": {"survey": {"baseline_scans": 1}}},
    )
    run_campaign(settings, tmp_path / "c")
    campaign = load_campaign(tmp_path / "c")
    none, dvl = campaign.runs.to_dict("records")
    assert (none["navigation"], dvl["navigation"]) == ("none", "dvl")
    assert math.isnan(none["time_s"]) and math.isnan(none["pose_error_position_max_m"])
    assert dvl["pose_error_position_max_m"] > 0 and dvl["true_poses_solid_exact_f1"] > 0
    moments = campaign.curves[campaign.curves["navigation"] == "dvl"]["time_s"]
    assert 0 < moments.iloc[-1] <= dvl["time_s"]
    assert "mean over time" in (tmp_path / "c/report.html").read_text()
    names, rows = query(tmp_path / "c", "select navigation from runs where time_s is null")
    assert (names, rows) == (["navigation"], [("none",)])


def test_a_damaged_part_is_named(folder: Path) -> None:
    (part,) = (folder / "parts").iterdir()
    part.write_bytes(part.read_bytes()[:100])
    with pytest.raises(ResultError, match=f"{part.name}: cannot be read as a run's part.*delete"):
        run_campaign(_settings(), folder)
    part.unlink()
    assert run_campaign(_settings(), folder).runs == 1
    (folder / "runs.parquet").write_bytes(b"PAR1")
    with pytest.raises(ResultError, match=r"runs.parquet: cannot be read as Parquet"):
        load_campaign(folder)


def test_one_process_at_a_time(folder: Path) -> None:
    with (folder / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with pytest.raises(OutputError, match="another process is at work on this campaign"):
            run_campaign(_settings(), folder)
    assert run_campaign(_settings(), folder).runs == 1


def test_killed_before_its_file_was_written_it_goes_on(folder: Path) -> None:
    (folder / "campaign.toml").unlink()
    with pytest.raises(OutputError, match="is no campaign; give another --out"):
        run_campaign(_settings(), folder)
    for name in ("runs.parquet", "curves.parquet", "seconds.parquet", "report.html", "result.json"):
        (folder / name).unlink()
    assert run_campaign(_settings(), folder).runs == 1


def test_a_wrong_campaign_makes_no_folder(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="tetrapot"):
        run_campaign(_settings(scenarios=["tetrapot"]), tmp_path / "c")
    assert not (tmp_path / "c").exists()


def test_stopped_before_its_first_run_it_has_no_rows(tmp_path: Path) -> None:
    result = run_campaign(_settings(), tmp_path / "c", should_stop=lambda: True)
    assert (result.runs, result.planned, result.table) == (0, 1, ())
    assert len(load_campaign(tmp_path / "c").runs) == 0
    assert "<b>0</b>runs" in (tmp_path / "c/report.html").read_text()
    assert query(tmp_path / "c", "select run from runs") == (["run"], [])
