"""The bus: what others hear and say there, and both ends of a mission in two processes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.bag_samples import plain_bag

from insonify.errors import ConfigError
from insonify.io.recordings.recording import Reading
from insonify.io.recordings.ros import messages
from insonify.live import publishing
from insonify.live.counts import Counts
from insonify.live.planning import Desk, Pilot
from insonify.live.played import PING_TOPICS
from insonify.live.poser import Poser
from insonify.live.publishing import ANSWERS, MAP, PATH, REQUEST, Publisher
from insonify.live.running import Order, run_session
from insonify.live.session import Finished, Heard, Session, Tick
from insonify.mapping.factory import make_mapper
from insonify.mapping.mapper import MappingSettings
from insonify.mission.remap import Remap
from insonify.planning.active import EntropySettings
from insonify.results.map import MapConfig
from insonify.results.replay import posed_messages
from insonify.types import Box, FanGeometry, Ping, Pose, PosedPing

SMALL = ["--set", "mapping.voxel_m=0.25"]
AREA = "-5.05 -4.85 -19.8 5.05 4.85 -16.317"


def everything(topic: str, kind: str) -> bool:
    return True


def hear(bus: Any, count: int, wanted: Any = everything) -> list[Any]:
    came: list[Any] = []
    until = time.monotonic() + 20.0
    while len(came) < count and time.monotonic() < until:
        came += bus.poll(wanted, 0.1)
    return came


def await_match(bus: Any, topic: str, other: Any) -> None:
    until = time.monotonic() + 20.0
    while not bus.listeners(topic) and time.monotonic() < until:
        other.poll(everything, 0.05)


def test_a_plain_dds_program_is_understood_and_understands(domain: int) -> None:
    """Held against types written by hand, as rosidl names them."""
    from cyclonedds.core import Policy, Qos
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.idl import make_idl_struct
    from cyclonedds.pub import DataWriter
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic
    from cyclonedds.util import duration

    from insonify.live.bus import Bus

    string: Any = make_idl_struct("String_", "std_msgs::msg::dds_::String_", {"data": str})
    participant = DomainParticipant(domain)
    said = Topic(participant, "rt/said", string)
    best_effort = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(5))
    writer = DataWriter(participant, said, qos=best_effort)
    reliable = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepAll)
    reader = DataReader(participant, Topic(participant, "rt/answer", string), qos=reliable)
    with Bus() as bus:
        bus.writer("/answer", "std_msgs/msg/String")
        until = time.monotonic() + 20.0
        while not (writer.get_matched_subscriptions() and bus.listeners("/answer")):
            bus.poll(everything, 0.05)
            assert time.monotonic() < until
        writer.write(string("hello, bus"))
        (heard,) = hear(bus, 1)
        assert (heard.topic, heard.kind) == ("/said", "std_msgs/msg/String")
        assert heard.decode().data == "hello, bus"
        assert 0 < heard.sent_ns <= heard.time_ns
        bus.publish("/answer", messages.new("std_msgs/String", data="hello, program"))
        assert reader.take_one(timeout=duration(seconds=20)).data == "hello, program"


def test_all_that_is_published_comes_as_it_was(domain: int, rng: np.random.Generator) -> None:
    from insonify.live.bus import Bus

    fan = FanGeometry(1.0, 0.2, 32, 100, 0.2, 8.0)
    ping = Ping(rng.random((100, 32), dtype=np.float32), fan)
    pose = Pose(1.0, 2.0, -3.0, 0.1, 0.2, 0.3)
    sent = {
        "/image": messages.sonar_image(ping, 5, "sonar", 1e6, 1500.0),
        "/state": messages.ping_state(ping, pose, None, np.zeros(0, np.uint64), 5, "sonar"),
        "/odometry": messages.odometry(pose, 5, "odom"),
        PATH: messages.path((pose, pose), 5, "map"),
        MAP: messages.point_cloud(rng.random((7, 4)), ("x", "y", "z", "probability"), 5, "map"),
    }
    with Bus() as one, Bus() as other:
        latched = messages.transforms([("a", "b", np.eye(4))], 5)
        one.publish("/tf_static", latched, latched=True)
        (late,) = hear(other, 1)  # was said before
        assert late.decode() == latched
        for topic, message in sent.items():
            one.writer(topic, message.__msgtype__)
            await_match(one, topic, other)
            one.publish(topic, message)
            (came,) = hear(other, 1)
            store = messages.message_types()
            again = store.serialize_cdr(came.decode(), came.kind)
            assert bytes(again) == bytes(store.serialize_cdr(message, came.kind))
        assert other.lost == 0
        assert set(other.topics) == {*sent, "/tf_static"}


def test_writers_that_offer_less_are_heard_too(domain: int) -> None:
    """A topic is read as all of its writers offer it: those that come later offer no more."""
    from cyclonedds.core import Policy, Qos
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.idl import make_idl_struct
    from cyclonedds.pub import DataWriter
    from cyclonedds.topic import Topic

    from insonify.live.bus import Bus

    string: Any = make_idl_struct("String_", "std_msgs::msg::dds_::String_", {"data": str})
    with Bus() as one, Bus() as other:
        one.publish("/said", messages.new("std_msgs/String", data="reliable"), latched=True)
        (heard,) = hear(other, 1)
        assert heard.decode().data == "reliable"
        participant = DomainParticipant(domain)
        best_effort = Qos(Policy.Reliability.BestEffort)
        writer = DataWriter(participant, Topic(participant, "rt/said", string), qos=best_effort)
        said: set[str] = set()
        until = time.monotonic() + 20.0
        while said != {"one", "two"} and time.monotonic() < until:
            one.publish("/said", messages.new("std_msgs/String", data="one"))
            writer.write(string("two"))
            said |= {message.decode().data for message in other.poll(everything, 0.1)}
            said -= {"reliable"}
        assert said == {"one", "two"}


def test_what_makes_room_for_later_messages_is_counted(
    domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However long nobody takes anything: what came is the newest and what is counted."""
    from insonify.live import bus as bus_module
    from insonify.live.bus import Bus

    monkeypatch.setattr(bus_module, "SMALL_DEPTH", 5)
    with Bus() as one, Bus() as other:
        for topic in ("/said", "/told"):
            one.writer(topic, "std_msgs/msg/String")
            await_match(one, topic, other)
        for number in range(3000):  # more than any queue of DDS holds
            one.publish("/said", messages.new("std_msgs/String", data=f"{number}"))
        one.publish("/told", messages.new("std_msgs/String", data="all"))
        until = time.monotonic() + 20.0
        while other.overwritten < 2995 and time.monotonic() < until:
            time.sleep(0.01)
        came = [message.decode().data for message in hear(other, 6)]
        assert sorted(came) == sorted(["2995", "2996", "2997", "2998", "2999", "all"])
        assert other.overwritten == 2995 and other.lost == 0


def test_a_session_that_is_behind_says_so(domain: int, monkeypatch: pytest.MonkeyPatch,
                                          tmp_path: Path) -> None:  # fmt: skip
    """What it takes and what it had no room for are all that was sent."""
    from insonify.live import bus as bus_module
    from insonify.live.bus import Bus
    from insonify.live.wiring import await_listener, counting_losses, heard

    monkeypatch.setattr(bus_module, "LARGE_DEPTH", 4)
    monkeypatch.setattr(bus_module, "SMALL_DEPTH", 4)
    monkeypatch.setattr("insonify.results.map._report", lambda remap, path: None)
    fan, sent = FanGeometry(1.0, 0.3, 16, 40, 0.5, 8.0), 0
    poser, said = Poser(Reading(), Counts()), []
    publisher = Publisher([lambda topic, message: said.append((topic, message))], every_s=0.05)

    def slow(session: Session, event: Any) -> None:
        if isinstance(event, Heard):
            time.sleep(0.05)

    def robot() -> None:
        nonlocal sent
        with Bus() as bus:
            await_listener(bus, PING_TOPICS, "/sonar/image", 20.0)
            for k in range(1, 41):
                posed = PosedPing(Ping(np.eye(40, 16, dtype=np.float32), fan),
                                  Pose(0.1 * k, 0.0, -5.0))  # fmt: skip
                told = posed_messages("sonar", posed, k * 10**9, 1e6, 1500.0)
                for topic, message in told.items():
                    bus.publish(topic, message)
                    sent += topic in other.topics
            time.sleep(1.0)

    with Bus() as other:
        thread = threading.Thread(target=robot)
        thread.start()
        watchers = [slow, counting_losses(other), publisher.watch]
        order = Order(MapConfig(mapping=MappingSettings(voxel_m=0.5)), None, tmp_path / "L")
        run_session(order, poser, heard(other, poser, publisher, 4.0), watchers)
        thread.join()
    counts = poser.counts
    assert counts.overwritten > 0 and counts.lost == 0
    assert counts.messages + counts.overwritten == sent
    assert counts.longest_gap_s >= 2.0
    account = json.loads((tmp_path / "L/live.json").read_text())
    assert account["overwritten"] == counts.overwritten
    told = [message.status[0] for topic, message in said if topic == "/diagnostics"]
    assert any(one.level == 1 and "were overwritten" in one.message for one in told)
    values = {value.key: value.value for value in told[-1].values}
    assert values["overwritten"] == str(counts.overwritten)


def test_a_domain_that_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("cyclonedds")
    from insonify.live.bus import Bus

    for text in ("-1", "233", "home"):
        monkeypatch.setenv("ROS_DOMAIN_ID", text)
        with pytest.raises(ConfigError, match="ROS_DOMAIN_ID is"):
            Bus()


def test_answers_and_health(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    from insonify.mission.remap import map_ping

    monkeypatch.setattr(publishing, "_MOST_SHARE", 1e9)  # the map is sent at every event
    settings = MappingSettings(voxel_m=0.25)
    remap = Remap(settings, make_mapper("bayes", settings))
    fan = FanGeometry(1.0, 0.3, 16, 40, 0.5, 8.0, Pose(0.0, 0.0, 0.0, pitch_rad=0.2))
    image = np.zeros((40, 16), np.float32)
    image[20:24] = 1.0
    far = Pose(500_000.0, 4_000_000.0, -10.0)
    sent: list[tuple[str, Any]] = []
    region = Box((499_990.0, 3_999_990.0, -20.0), (500_010.0, 4_000_010.0, -5.0))
    pilot = Pilot(region, EntropySettings(), 5, 0.4)
    publisher = Publisher(
        [lambda topic, message: sent.append((topic, message))],
        pilot,
        every_s=0.0,
        desk=Desk(beside=False),
    )
    session = Session(Poser(Reading(), Counts()), remap, [publisher.watch])

    class Asked:
        topic = REQUEST

        def __init__(self, word: str) -> None:
            self.word = word

        def decode(self) -> Any:
            return messages.new("std_msgs/String", data=self.word)

    for k in range(4):
        posed = PosedPing(Ping(image, fan, float(k)), far.moved((0.0, 0.1 * k, 0.0)))
        map_ping(remap, posed, "test")
        publisher.watch(session, Heard(posed, 10**9 * k))
    for word in ("map", "entropy", "path", "path", "nonsense"):
        assert publisher.hears(Asked(word))  # type: ignore[arg-type]
        publisher.watch(session, Tick())
    by_topic: dict[str, list[Any]] = {}
    for topic, message in sent:
        assert message.__msgtype__ == ANSWERS[topic]
        by_topic.setdefault(topic, []).append(message)
    cloud = by_topic[MAP][-1]
    rows = np.frombuffer(cloud.data.tobytes(), "<f4").reshape(-1, 4)
    voxels = remap.mapper.voxels
    assert len(rows) == cloud.width == len(voxels.occupied_m()) > 0
    np.testing.assert_allclose(
        np.sort(rows[:, 0]), np.sort(voxels.occupied_m()[:, 0] + voxels.origin_m[0]), atol=0.05
    )
    assert len(by_topic["/insonify/entropy"]) == 1
    first, second = by_topic[PATH]
    assert first == second and first.header.stamp.sec == 3 and len(first.poses) >= 5
    start = first.poses[0].pose.position
    assert abs(start.x - 500_000.0) < 50.0 and start.z == -10.0
    publisher.watch(session, Heard(posed, 3 * 10**9))  # however long the plan took
    status = [message for topic, message in sent if topic == "/diagnostics"][-1].status[0]
    assert status.level == 0 and "next scan" in status.message
    publisher.hears(Asked("path"))  # type: ignore[arg-type]
    publisher.watch(session, Tick())
    again = [message for topic, message in sent if topic == PATH]
    assert again == [first] * 3, "nothing has come since"
    pilot.clearance_m = 50.0
    publisher._map_due_s, publisher.listens = 0.0, lambda topic: topic != MAP
    publisher.watch(session, Heard(posed, 10**10))
    assert len([topic for topic, _ in sent if topic == MAP]) == len(by_topic[MAP])
    publisher.hears(Asked("path"))  # type: ignore[arg-type]
    publisher.watch(session, Finished())
    refused = [message for topic, message in sent if topic == PATH][-1]
    assert not refused.poses and "50 m is the least" in publisher.words


def start(*words: str, cwd: Path) -> subprocess.Popen[str]:
    line = [sys.executable, "-m", "insonify", *words]
    return subprocess.Popen(
        line, cwd=cwd, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=os.environ
    )


def done(process: subprocess.Popen[str], code: int = 0) -> str:
    out, told = process.communicate(timeout=120)
    assert process.returncode == code, told
    return out


@pytest.mark.slow
def test_a_mission_in_two_processes(domain: int, tmp_path: Path) -> None:
    """The robot flies where `live` says, until it says that no scan pays; one map for both."""
    plan = ["--plan", "--region", AREA, "--waypoints", "8", "--set", "entropy.max_scans=2"]
    words = ["scan", "tetrapod", "--live-bus", *SMALL, "--set", "survey.waypoints=8"]
    robot = start(*words, "--out", "R", cwd=tmp_path)  # waits for the other longer than that for it
    live = start("live", *SMALL, *plan, "--out", "L", "--json", cwd=tmp_path)
    done(robot)
    live.send_signal(signal.SIGTERM)
    account = json.loads(done(live))
    robots = (tmp_path / "R/map.npz").read_bytes()
    assert (tmp_path / "L/map.npz").read_bytes() == robots
    done(start("map", "L/recordings/001.mcap", *SMALL, "--out", "M", cwd=tmp_path))
    assert (tmp_path / "M/map.npz").read_bytes() == robots
    result = json.loads((tmp_path / "R/result.json").read_text())
    assert result["stop_reason"] == "not_worth_it" and 1 < result["scans"] <= 3
    heard = account["messages"]
    assert heard["mapped"] == heard["pings"] == result["pings"]
    assert heard["lost"] == 0 and heard["latency_ms"]["median"] < 1000.0


@pytest.mark.slow
def test_a_tour_on_the_bus(domain: int, tmp_path: Path) -> None:
    """Odometry at every tick; the tour ends when nothing is worth flying."""
    (tmp_path / "one.toml").write_text(
        '[[sonars]]\nname = "fls"\nrate_hz = 4\nsonar = "park-2025"\n', encoding="utf-8"
    )
    plan = ["--plan", "--region", "90 90 -19 95 95 -17"]
    way = ["--waypoints", "-6 0 -15 0; -5.5 0 -15 0", "--navigation", "truth"]
    fly = ["fly", "tetrapod", "--sonars", "one.toml", *way, "--live", "--out", "F", "--json"]
    robot = start(*fly, cwd=tmp_path)
    live = start("live", *SMALL, *plan, "--out", "L", cwd=tmp_path)
    result = json.loads(done(robot))
    live.send_signal(signal.SIGTERM)
    done(live)
    assert result["stop_reason"] == "not_worth_it" and result["pings"]["fls"] > 3
    account = json.loads((tmp_path / "L/live.json").read_text())
    assert account["mapped"] == result["pings"]["fls"] and account["poses"] > account["pings"]
    done(start("map", "F/fls.npz", *SMALL, "--out", "M", cwd=tmp_path))
    assert (tmp_path / "L/map.npz").read_bytes() == (tmp_path / "M/map.npz").read_bytes()


@pytest.mark.slow
def test_a_bag_of_another_program_over_the_bus(
    domain: int, tmp_path: Path, rng: np.random.Generator
) -> None:
    """Odometry between pings: what `play` sends is mapped as `map` maps the bag."""
    plain_bag(tmp_path / "bag", "mcap", rng, 6)
    voxel = ["--voxel", "0.1"]
    player = start("play", "bag/bag.mcap", "--rate", "5", cwd=tmp_path)
    live = start("live", *voxel, "--idle", "5", "--out", "L", cwd=tmp_path)
    done(player)
    done(live)
    done(start("map", "bag/bag.mcap", *voxel, "--out", "M", cwd=tmp_path))
    assert (tmp_path / "L/map.npz").read_bytes() == (tmp_path / "M/map.npz").read_bytes()
