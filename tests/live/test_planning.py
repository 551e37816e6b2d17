"""The next path: never nearer to what is mapped than the clearance, whatever is mapped."""

from __future__ import annotations

import itertools
import json
import math
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from insonify.errors import MemoryLimitError
from insonify.io.maps import load_map, ondisk, save_map
from insonify.io.recordings.recording import Reading
from insonify.io.recordings.ros import messages
from insonify.io.recordings.ros.mcap_writing import McapWriter
from insonify.live import health
from insonify.live.counts import Counts
from insonify.live.health import Pulse
from insonify.live.planning import Answer, Desk, Pilot, Question
from insonify.live.poser import Poser
from insonify.live.publishing import DIAGNOSTICS, PATH, REQUEST, Publisher
from insonify.live.session import Finished, Heard, Session, Tick
from insonify.mapping.bayes import BayesMapper
from insonify.mapping.factory import make_mapper
from insonify.mapping.mapper import Mapper, MappingSettings
from insonify.mapping.store import cell_of
from insonify.mapping.voxels import IN_VIEW, OBSERVED, VoxelMap
from insonify.mission.remap import Remap, map_ping
from insonify.planning.active import EntropySettings
from insonify.results.replay import posed_messages
from insonify.types import Box, FanGeometry, Ping, Pose, PosedPing, ScanPath

FAN = FanGeometry(1.2, 0.3, 16, 40, 0.5, 8.0, Pose(0.0, 0.0, 0.0, pitch_rad=0.3))
VOXEL_M = 0.25


def random_map(seed: int, blocks: int) -> VoxelMap:
    """Blobs that are occupied, free and undecided, around where the vehicle is."""
    rng = np.random.default_rng(seed)
    voxels = VoxelMap(VOXEL_M)
    voxels.allocate(rng.integers(-4, 4, (blocks, 3)).astype(np.int32))
    shape = voxels.log_odds.shape
    voxels.log_odds[:] = rng.choice([-3.0, 0.0, 0.05, 3.0], shape, p=[0.5, 0.3, 0.1, 0.1])
    voxels.seen[:] = rng.choice([0, IN_VIEW, IN_VIEW | OBSERVED], shape)
    return voxels


def nearest_m(voxels: VoxelMap, way: list[Pose]) -> float:
    """Least distance of a way, sampled every centimetre, to a cube that is occupied."""
    centres = voxels.occupied_m()
    least = math.inf
    for start, end in itertools.pairwise(way):
        steps = max(2, round(math.dist(start.position_m, end.position_m) / 0.05))
        for share in np.linspace(0.0, 1.0, steps):
            place = (1 - share) * np.array(start.position_m) + share * np.array(end.position_m)
            outside = np.maximum(np.abs(centres - place) - voxels.voxel_m / 2, 0.0)
            least = min(least, float(np.linalg.norm(outside, axis=1).min(initial=math.inf)))
    return least


EXAMPLES = max(60, settings.default.max_examples if settings.default else 0)
"""500 others each time with ``--hypothesis-profile=many``, see `tests/conftest.py`."""
CHOSEN = EntropySettings(termination=0.0, high_entropy=0.9, min_samples=2)


def walled_map(seed: int, blocks: int, walls: int) -> VoxelMap:
    """A random map with walls across it: straight ways are barred, and ways round are not."""
    voxels, rng = random_map(seed, blocks), np.random.default_rng(seed + 1)
    for _ in range(walls):
        middle, half_m = rng.uniform(-7.0, 7.0, 3), rng.uniform(0.5, 3.0)
        along = rng.integers(0, 2)
        cells = np.array([
            [0 if along else k, k if along else 0, z]
            for k in range(-int(half_m / VOXEL_M), int(half_m / VOXEL_M) + 1)
            for z in range(-30, 30)
        ]) + (middle * [1, 1, 0] / VOXEL_M).astype(int)  # fmt: skip
        slots = voxels.allocate((cells // 8).astype(np.int32))
        voxels.log_odds[slots, cell_of(cells)] = 3.0
        voxels.seen[slots, cell_of(cells)] = IN_VIEW | OBSERVED
    return voxels


def mapper_of(voxels: VoxelMap) -> BayesMapper:
    mapper = BayesMapper(MappingSettings(voxel_m=VOXEL_M))
    mapper.voxels = voxels
    return mapper


def asked(pilot: Pilot, mapper: Mapper, pose: Pose) -> Answer:
    return pilot.answer(pilot.question(mapper, FAN, pose))


@settings(max_examples=EXAMPLES, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    blocks=st.integers(1, 12),
    walls=st.integers(0, 3),
    x=st.floats(-9.0, 9.0),
    y=st.floats(-9.0, 9.0),
    z=st.floats(-2.0, 6.0),
    clearance_m=st.one_of(st.floats(0.0, 0.6), st.floats(0.0, 3.0)),
)
def test_no_path_comes_below_the_clearance(
    seed: int, blocks: int, walls: int, x: float, y: float, z: float, clearance_m: float
) -> None:
    """The scan, the way there and all that leads round; and as the whole map has it."""
    mapper = mapper_of(walled_map(seed, blocks, walls))
    pose = Pose(x, y, z, yaw_rad=0.3)
    pilot = Pilot(None, CHOSEN, 5, clearance_m)
    answer = asked(pilot, mapper, pose)
    whole = pilot.answer(Question(mapper, None, FAN, pose, 0))
    assert (answer.path, answer.way, answer.why) == (whole.path, whole.way, whole.why)
    if answer.path is None:
        assert answer.why
        return
    assert answer.way[-1] == answer.path.waypoints[0]
    assert nearest_m(mapper.voxels, [pose, *answer.waypoints]) >= clearance_m - 1e-9
    assert answer.clear_m >= clearance_m


def test_some_paths_are_straight_some_lead_round_and_some_are_refused() -> None:
    """So that the property above says something."""
    straight = round_ = refused = 0
    for seed in range(30):
        mapper = mapper_of(walled_map(seed, 3, 4))
        for clearance_m in (0.3, 30.0):
            answer = asked(Pilot(None, CHOSEN, 5, clearance_m), mapper, Pose(-9.0, 2.0, 1.0))
            straight += len(answer.way) == 1
            round_ += len(answer.way) > 1
            refused += "is the least" in answer.why
    assert straight >= 3 and round_ >= 3 and refused >= 3, (straight, round_, refused)


def test_a_region_far_away_and_a_small_one_are_planned_as_with_the_whole_map() -> None:
    """What is copied is what the plan depends on, no more of the map."""
    for seed in range(20):
        mapper = mapper_of(walled_map(seed, 12, 3))
        far = mapper.voxels.allocate(np.array([[90, 0, 0], [91, 3, 40]], np.int32))
        mapper.voxels.log_odds[far] = 3.0
        region = Box((-3.0, -2.0, -4.0), (3.0, 4.0, 1.0))
        pose = Pose(-6.0, 2.0, 1.0)
        pilot = Pilot(region, CHOSEN, 5, 0.3)
        question = pilot.question(mapper, FAN, pose)
        assert question.belief.voxels.block_count < mapper.voxels.block_count
        few = pilot.answer(question)
        whole = pilot.answer(Question(mapper, region, FAN, pose, 0))
        assert (few.path, few.way, few.why) == (whole.path, whole.way, whole.why)


def test_a_map_on_disk_is_planned_from_as_one_in_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ondisk, "LEAST_BYTES", 0)
    voxels = walled_map(3, 12, 3)
    save_map(voxels, tmp_path / "map.zarr")
    held = load_map(tmp_path / "map.zarr", memory_bytes=600 * 2560)
    pose, answers = Pose(-6.0, 2.0, 1.0), []
    for region in (None, Box((-3.0, -2.0, -4.0), (3.0, 4.0, 1.0))):
        pilot = Pilot(region, CHOSEN, 5, 0.3)
        one, other = (asked(pilot, mapper_of(some), pose) for some in (voxels, held))
        assert (one.path, one.way, one.why) == (other.path, other.way, other.why)
        answers.append(one.path)
    assert not held.in_memory and any(answers)


def test_the_most_scans_are_kept_to() -> None:
    pilot = Pilot(None, EntropySettings(max_scans=1), 5, 0.4, sent=1)
    answer = asked(pilot, BayesMapper(MappingSettings()), Pose(0.0, 0.0, 0.0))
    assert answer.path is None and "entropy.max_scans" in answer.why


def test_a_path_that_was_not_begun_is_no_scan() -> None:
    """Asked twice at a scan's end, as a vehicle does that is not quite there the first time."""
    pilot = Pilot(None, EntropySettings(max_scans=2), 5, 0.4)
    paths = [ScanPath((Pose(k, 0.0, 0.0), Pose(k + 5.0, 0.0, 0.0))) for k in (1.0, 2.0, 30.0)]
    for path in paths[:2]:
        pilot.sends(Answer(path, ""))
    assert pilot.sent == 1
    assert not pilot.flown(Pose(2.0, 0.0, 0.0)) and pilot.flown(Pose(7.0, 0.0, 0.0))
    pilot.sends(Answer(paths[2], ""))
    assert pilot.sent == 2
    mapper = BayesMapper(MappingSettings())
    assert "max_scans" not in asked(pilot, mapper, Pose(7.0, 0.0, 0.0)).why, "in its place"
    pilot.flown(Pose(30.0, 0.0, 0.0))
    assert "max_scans" in asked(pilot, mapper, Pose(31.0, 0.0, 0.0)).why


class Pings:
    """A session that can be told of pings, and what it sends."""

    def __init__(self, publisher: Publisher) -> None:
        settings = MappingSettings(voxel_m=VOXEL_M)
        remap = Remap(settings, make_mapper("bayes", settings))
        self.publisher = publisher
        self.session = Session(Poser(Reading(), Counts()), remap, [publisher.watch])
        self.sent: list[Any] = []
        publisher.send.append(self._send)

    def _send(self, topic: str, message: Any) -> None:
        if topic == PATH:
            self.sent.append(message)

    def map(self, number: int) -> None:
        image = np.zeros((40, 16), np.float32)
        image[20:24] = 1.0
        posed = PosedPing(Ping(image, FAN, float(number)), Pose(0.1 * number, 0.0, -5.0))
        map_ping(self.session.remap, posed, "test")
        self.session.counts.mapped += 1
        self.session.tell(Heard(posed, number * 10**9))

    def ask(self) -> None:
        class Asked:
            topic = REQUEST

            def decode(self) -> Any:
                return messages.new("std_msgs/String", data="path")

        assert self.publisher.hears(Asked())  # type: ignore[arg-type]
        self.session.tell(Tick())

    def until_sent(self, count: int) -> None:
        limit = time.monotonic() + 60.0
        while len(self.sent) < count:
            assert time.monotonic() < limit
            time.sleep(0.01)
            self.session.tell(Tick())


def test_pings_are_mapped_while_a_path_is_planned(monkeypatch: pytest.MonkeyPatch) -> None:
    """A request meanwhile is counted, and answered after it, of the map of then."""
    begun, go_on = threading.Semaphore(0), threading.Semaphore(0)
    answer = Pilot.answer
    seen: list[int] = []

    def slow(self: Pilot, question: Question) -> Answer:
        begun.release()
        assert go_on.acquire(timeout=60.0)
        seen.append(question.belief.voxels.block_count)
        return answer(self, question)

    monkeypatch.setattr(Pilot, "answer", slow)
    chosen = EntropySettings(termination=0.0, min_samples=2)
    pings = Pings(Publisher([], Pilot(None, chosen, 5, 0.2)))
    pings.map(1)
    known = pings.session.remap.mapper.voxels.block_count
    pings.ask()
    assert begun.acquire(timeout=60.0)
    for number in range(2, 60):  # it goes on
        pings.map(number)
    pings.ask()
    pings.ask()
    counts = pings.session.counts
    assert (counts.mapped, counts.paths_asked, counts.paths_held) == (59, 3, 2)
    assert not pings.sent
    go_on.release()
    pings.until_sent(1)
    assert begun.acquire(timeout=60.0)
    go_on.release()
    pings.until_sent(2)
    pings.session.tell(Finished())
    assert [message.header.stamp.sec for message in pings.sent] == [1, 59]
    assert all(message.poses for message in pings.sent)
    assert seen[0] == known < seen[1], "it was planned from what was mapped when it was asked for"
    assert counts.paths_sent == 2
    alone = Pings(Publisher([], Pilot(None, chosen, 5, 0.2), desk=Desk(beside=False)))
    go_on.release()
    alone.map(1)
    alone.ask()
    assert alone.sent == pings.sent[:1], "at once and beside the mapping it is the same"


def test_a_plan_at_the_end_leaves_the_session_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its answer is an event after the last: no heartbeat, and health stays what it is."""
    monkeypatch.setattr(health, "BEAT_S", 0.0)
    said: list[Any] = []
    chosen = EntropySettings(termination=0.0, min_samples=2)
    publisher = Publisher([], Pilot(None, chosen, 5, 0.2), plans_at_end=True)
    pings = Pings(publisher)
    pings.session.watchers.insert(0, Pulse(tmp_path).watch)
    publisher.send.append(lambda topic, message: said.append((topic, message)))
    pings.map(1)
    pings.ask()
    assert list(tmp_path.iterdir())
    pings.session.tell(Finished())
    assert pings.sent and not list(tmp_path.iterdir())
    told = [message.status[0].message for topic, message in said if topic == DIAGNOSTICS]
    assert told[-1] == "ended"


def test_what_goes_wrong_with_a_plan_is_an_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*words: object) -> None:
        raise MemoryLimitError("no memory")

    for name in ("answer", "question"):
        monkeypatch.setattr(Pilot, name, fails)
        pings = Pings(Publisher([], Pilot(None, CHOSEN, 5, 0.2)))
        pings.map(1)
        pings.ask()
        pings.session.tell(Finished())
        (said,) = pings.sent
        assert not said.poses and "no memory" in pings.publisher.words


@pytest.mark.slow
def test_a_recording_that_asks_is_answered_the_same_each_time(
    tmp_path: Path, run: Callable[..., str]
) -> None:
    """Of the map as it was at the request, and at its end, where `plan` has the same."""
    with McapWriter(tmp_path / "dive.mcap") as writer:
        for k in range(1, 13):
            image = np.zeros((40, 16), np.float32)
            image[20:24] = 1.0
            posed = PosedPing(Ping(image, FAN), Pose(0.2 * k, 0.0, -5.0))
            for topic, message in posed_messages("sonar", posed, k * 10**9, 1e6, 1500.0).items():
                writer.write(topic, message, k * 10**9)
            if k in (5, 9):
                asked = messages.new("std_msgs/String", data="path")
                writer.write(REQUEST, asked, k * 10**9 + 1)
    few = ["--voxel", "0.25", "--region", "-2 -6 -12 12 6 -6", "--waypoints", "6"]
    few += ["--set", "entropy.termination=0", "--set", "entropy.min_samples=2"]
    plans = []
    for name in ("one", "two"):
        run("live", "--from", "dive.mcap", "--plan", *few, "--out", name, code=0)
        plans.append(json.loads((tmp_path / name / "live.json").read_text())["plans"])
    assert plans[0] == plans[1]
    assert [plan["stamp_ns"] for plan in plans[0]] == [5 * 10**9, 9 * 10**9, 12 * 10**9]
    assert all(plan["waypoints"] for plan in plans[0])
    words = ["plan", "one", "--from", "2.4 0 -5 0", "--waypoints", "6", "--out", "next"]
    words += ["--region", few[3], *few[6:]]
    run(*words, code=0)
    decision = json.loads((tmp_path / "next/decision.json").read_text())
    start = plans[0][-1]["waypoints"][-2]
    assert decision["start"] == pytest.approx(start, abs=1e-3)


def test_a_scan_is_flown_when_its_begin_and_then_its_end_were_reached() -> None:
    pilot = Pilot(None, EntropySettings(), 5, 0.4)
    assert not pilot.flown(Pose(0.0, 0.0, 0.0))
    pilot._ahead = ScanPath((Pose(5.0, 0.0, 0.0), Pose(10.0, 0.0, 0.0)))
    places = [0.0, 10.0, 8.0, 5.2, 7.0, 9.4]  # it passes the end on its way to the begin
    assert not any(pilot.flown(Pose(x, 0.0, 0.0)) for x in places)
    assert pilot.flown(Pose(9.6, 0.0, 0.0))
    assert not pilot.flown(Pose(10.0, 0.0, 0.0))


@pytest.mark.parametrize("words", ["live --out L", "play bag.npz", "scan tetrapod --live-bus"])
@pytest.mark.slow
def test_without_the_bus_it_says_what_to_install(words: str, tmp_path: object) -> None:
    import subprocess
    import sys
    from pathlib import Path

    from insonify.io.recordings.arrays import save_arrays
    from insonify.types import Ping, PosedPing

    folder = Path(str(tmp_path))
    ping = Ping(np.zeros((40, 16), np.float32), FAN)
    save_arrays(folder / "bag.npz", [PosedPing(ping, Pose(0.0, 0.0, -3.0))])
    code = (
        "import sys\nsys.modules['cyclonedds'] = None\n"
        f"sys.argv = ['insonify', *{words.split()!r}]\n"
        "from insonify.cli import main\nmain()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert "pip install 'insonify[live]'" in done.stderr and "Traceback" not in done.stderr
