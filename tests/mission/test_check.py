"""What `insonify check` finds in recordings that are taken wrongly."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.checking import FAULTS, spoilt
from typer.testing import CliRunner

from insonify.cli import app
from insonify.errors import RecordingError
from insonify.frames import world_from_sonar
from insonify.io.recordings import open_recording
from insonify.io.recordings.arrays import save_arrays
from insonify.io.recordings.poses import PoseTrack
from insonify.io.recordings.recording import Reading, Recording
from insonify.mapping.consistency import PingStack, View
from insonify.mapping.echoes import noise_threshold
from insonify.mission.check import check_recording
from insonify.mission.findings import Answer
from insonify.mission.setup import World, scenario_config
from insonify.types import FanGeometry, Ping, Pose, PosedPing


@pytest.fixture(scope="module")
def world() -> World:
    return World(scenario_config("tetrapod"))


def _recording(world: World, poses: list[Pose]) -> Recording:
    """Pings from poses, speckle on, twice a second."""
    rng = np.random.default_rng(3)
    pings = [
        PosedPing(replace(world.sonar.ping(world.scene, pose, rng), time_s=0.5 * number), pose)
        for number, pose in enumerate(poses)
    ]
    facts = {"columns": "port to starboard"}
    return Recording(Path("r"), "simulated", len(pings), True, facts, lambda: iter(pings))


def _around(count: int = 26) -> list[Pose]:
    """Most of the way around the object, looking in, past its middle."""
    poses = []
    for number in range(count):
        turn = 1.5 * math.pi * number / count
        place = 8.0 * math.cos(turn), 8.0 * math.sin(turn), -15.0
        poses.append(Pose(*place, yaw_rad=math.remainder(turn + math.pi + 0.1, math.tau)))
    return poses


@pytest.fixture(scope="module")
def orbit(world: World) -> Recording:
    return _recording(world, _around())


@pytest.mark.parametrize("fault", FAULTS)
def test_a_recording_taken_wrongly_is_found_out(orbit: Recording, fault: str) -> None:
    mirrored, tilted = FAULTS[fault]
    found = check_recording(spoilt(orbit, mirrored, tilted))
    assert found.side.answer.otherwise == mirrored and found.tilt.answer.otherwise == tilted
    assert found.side.answer in {Answer.RIGHT, Answer.WRONG}
    expected = {
        "none": (),
        "mirrored": ("--beams starboard-to-port",),
        "tilt": ('--mount "0 0 0 0 30 0"',),
        "upside down": ('--mount "0 0 0 180 30 0"',),
    }
    assert found.options == expected[fault]


def test_what_the_data_cannot_tell_is_not_told(world: World) -> None:
    """A straight track is its own mirror image; a level sonar has no tilt; noise says nothing."""
    ahead = [Pose(-12.0 + 0.2 * k, 0.3, -15.0) for k in range(40)]
    straight = check_recording(_recording(world, ahead))
    assert straight.side.answer is Answer.UNKNOWN and "straight track" in straight.side.why
    assert straight.tilt.answer is Answer.RIGHT  # by the seabed
    assert straight.conclusion == "its side cannot be told from its pings"
    rng = np.random.default_rng(1)
    level = FanGeometry(math.radians(60.0), math.radians(20.0), 60, 120, 0.0, 12.0)
    noise = [
        PosedPing(Ping(rng.rayleigh(0.05, (120, 60)).clip(0, 1).astype(np.float32), level, k), pose)
        for k, pose in enumerate(_around())
    ]
    recording = Recording(Path("n"), "noise", 40, True, {}, lambda: iter(noise))
    told = check_recording(recording)
    assert told.side.answer is Answer.UNKNOWN and told.tilt.answer is Answer.ALIKE
    assert told.clock is not None and told.clock.answer is Answer.UNKNOWN and not told.options


def _legs() -> list[tuple[float, Pose]]:
    """Four straight legs past the object, half a metre a ping, a minute between them."""
    legs = []
    for leg, heading in enumerate(np.radians([0.0, 100.0, 200.0, 290.0])):
        ahead, aside = np.array([math.cos(heading), math.sin(heading)]), 0.4 * (-1) ** leg
        for number in range(14):
            x, y = (-10.0 + 0.5 * number) * ahead + aside * np.array([-ahead[1], ahead[0]])
            turn = math.remainder(heading, math.tau)
            legs.append((60.0 * leg + 0.5 * number, Pose(x, y, -15.0, yaw_rad=turn)))
    return legs


@pytest.mark.slow
@pytest.mark.parametrize("late_s", [-1.0, 0.0, 1.0])
def test_a_clock_that_is_off_is_found(world: World, late_s: float) -> None:
    """Poses of another time."""
    rng, legs = np.random.default_rng(3), _legs()
    track = PoseTrack.of(legs)
    posed = [
        PosedPing(
            replace(world.sonar.ping(world.scene, pose, rng), time_s=time_s),
            track.at(time_s + late_s),
        )
        for time_s, pose in legs
    ]
    found = check_recording(Recording(Path("r"), "r", len(posed), True, {}, lambda: iter(posed)))
    assert found.clock is not None
    assert found.clock.answer is (Answer.RIGHT if late_s == 0.0 else Answer.WRONG)
    assert found.clock_offset_s == pytest.approx(-late_s, abs=0.35)
    assert found.side.answer is Answer.RIGHT and found.tilt.answer is Answer.RIGHT


def test_an_orbit_does_not_tell_the_clock(orbit: Recording) -> None:
    """The world turned about its middle is as good."""
    found = check_recording(orbit)
    assert found.clock is not None and found.clock.answer is Answer.UNKNOWN


def test_the_command_and_its_remedy(orbit: Recording, tmp_path: Path) -> None:
    """What it says to type sets the recording right."""
    path = tmp_path / "r.npz"
    save_arrays(path, list(spoilt(orbit, True, True).read()))
    run = CliRunner().invoke(app, ["check", str(path), "--json"])
    told: dict[str, Any] = json.loads(run.stdout)
    assert told["conclusion"] == "the sonar is mounted upside down"
    (option,) = told["options"]
    shown = CliRunner().invoke(app, ["check", str(path)])
    assert "upside down" in shown.stdout and option in shown.stdout
    numbers = option.removeprefix("--mount ").strip('"')
    again = CliRunner().invoke(app, ["check", str(path), "--json", "--mount", numbers])
    assert json.loads(again.stdout)["conclusion"] == "nothing speaks against it"
    mirrored = tmp_path / "m.npz"
    save_arrays(mirrored, list(spoilt(orbit, True, False).read()))
    again = CliRunner().invoke(
        app, ["check", str(mirrored), "--json", "--beams", "starboard-to-port"]
    )
    assert json.loads(again.stdout)["conclusion"] == "nothing speaks against it"


def test_too_few_pings_are_refused(orbit: Recording, tmp_path: Path) -> None:
    path = tmp_path / "r.npz"
    save_arrays(path, list(orbit.read())[:4])
    with pytest.raises(RecordingError, match="4 of its pings have a pose"):
        check_recording(open_recording(path, Reading()))


def test_noise_is_told_from_echoes() -> None:
    rng = np.random.default_rng(0)
    image = rng.rayleigh(0.02, (400, 64)).astype(np.float32)
    image[200:260] += 0.5
    threshold = noise_threshold([image, image])
    assert 0.08 < threshold < 0.14
    assert (image[:200] > threshold).mean() < 1e-4 and (image[200:260] > threshold).all()
    assert noise_threshold([np.zeros((8, 4), np.float32)]) == pytest.approx(1.5 / 255)


def test_a_view_agrees_with_itself_better_than_with_any_other(orbit: Recording) -> None:
    pings = list(orbit)
    fan = pings[0].ping.geometry
    stack = PingStack(fan, [one.ping.image for one in pings], 0.1)
    right = np.stack([world_from_sonar(one.pose, fan.mount) for one in pings if one.pose])
    wrong = right.copy()
    wrong[:, :2, 3] += np.random.default_rng(0).normal(0.0, 0.7, (len(pings), 2))
    verdict = stack.contest(View(right), View(wrong))
    assert min(verdict.gains) > 0.05 and max(verdict.sigmas) > 3.0
    back = stack.contest(View(wrong), View(right))
    assert back.gains == pytest.approx(tuple(-gain for gain in verdict.gains))
    assert stack.contest(View(right), View(right)).pings == 0


@pytest.mark.parametrize("yaw_deg", [20.0, 90.0])
def test_a_mount_that_looks_aside_is_told_like_one_ahead(orbit: Recording, yaw_deg: float) -> None:
    """The tilt of the other sign looks to the same side."""
    aside = math.radians(yaw_deg)

    def read() -> Iterator[PosedPing]:
        for one in orbit.read():
            assert one.pose is not None
            mount = replace(one.ping.geometry.mount, yaw_rad=aside)
            ping = replace(one.ping, geometry=replace(one.ping.geometry, mount=mount))
            yield replace(one, ping=ping, pose=replace(one.pose, yaw_rad=one.pose.yaw_rad - aside))

    turned = replace(orbit, read=read)
    right = check_recording(turned)
    assert not right.side.answer.otherwise and right.tilt.answer is Answer.RIGHT
    wrong = check_recording(spoilt(turned, False, True))
    assert not wrong.side.answer.otherwise and wrong.tilt.answer is Answer.WRONG
    assert wrong.options == (f'--mount "0 0 0 0 30 {yaw_deg:g}"',)
