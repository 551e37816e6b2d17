"""The types of pings that recordings know, over the bus: heard as they are read, or refused."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.bag_samples import BagMaker, definitions_of
from PIL import Image

from insonify.errors import ConfigError
from insonify.io.maps import save_map
from insonify.io.recordings import open_recording
from insonify.io.recordings.recording import Reading
from insonify.io.recordings.ros.messages import message_types
from insonify.io.recordings.ros.workspaces import PREFIXES, fields_of
from insonify.live.counts import Counts
from insonify.live.poser import Poser
from insonify.live.publishing import Publisher
from insonify.live.running import Order, run_session
from insonify.live.session import Event, Session
from insonify.mapping.mapper import MappingSettings
from insonify.mission.remap import map_recordings
from insonify.results.map import MapConfig

BINS, BEAMS = 20, 8
AZIMUTHS = np.radians(np.linspace(14.0, -14.0, BEAMS))
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])
HOW = MapConfig(mapping=MappingSettings(voxel_m=0.1))


def png(image: Any) -> Any:
    import io

    file = io.BytesIO()
    Image.fromarray(image).save(file, "PNG")
    return np.frombuffer(file.getvalue(), np.uint8)


def projected(maker: BagMaker, time_s: float, image: Any) -> Any:
    return maker.projected(time_s, image, AZIMUTHS, 0.5 + 0.05 * np.arange(BINS), 0.2)


def oculus(maker: BagMaker, time_s: float, image: Any) -> Any:
    header = maker.header(time_s, "sonar")
    picture = maker.new("sensor_msgs/CompressedImage", header=header, format="png", data=png(image))
    return maker.new(
        "sonar_oculus/OculusPing", header=header, ping_id=1, range_resolution=0.05,
        num_ranges=BINS, num_beams=BEAMS,
        bearings=np.round(-np.degrees(AZIMUTHS) * 100).astype(np.int16), ping=picture,
    )  # fmt: skip


def fan(maker: BagMaker, time_s: float, image: Any) -> Any:
    """A driver's own type, known by its fields."""
    header = maker.header(time_s, "sonar")
    picture = maker.new(
        "sensor_msgs/Image", header=header, height=BINS, width=BEAMS, encoding="mono8",
        is_bigendian=0, step=BEAMS, data=image.reshape(-1),
    )  # fmt: skip
    return maker.new(
        "other_driver/Fan", header=header, num_ranges=BINS, range_resolution=0.05,
        bearings=-AZIMUTHS.astype(np.float32), ping=picture,
    )  # fmt: skip


def echo(maker: BagMaker, time_s: float, image: Any) -> Any:
    return maker.new(
        "ping360_sonar_msgs/SonarEcho", header=maker.header(time_s, "sonar"), angle=0.1, gain=1,
        number_of_samples=BINS, transmit_frequency=740, speed_of_sound=1500, range=2,
        intensities=np.ascontiguousarray(image[:, 0]),
    )  # fmt: skip


PINGS: dict[str, Callable[[BagMaker, float, Any], Any]] = {
    "marine_acoustic_msgs/msg/ProjectedSonarImage": projected,
    "sonar_oculus/msg/OculusPing": oculus,
    "other_driver/msg/Fan": fan,
    "ping360_sonar_msgs/msg/SonarEcho": echo,
}


def workspace(folder: Path, *kinds: str) -> Path:
    """A ROS workspace as `colcon` installs one, of some packages."""
    for kind in kinds:
        package, _, name = kind.split("/")
        file = folder / "share" / package / "msg" / f"{name}.msg"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(definitions_of(kind), encoding="utf-8")
    return folder


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::insonify.io.recordings.recording.RecordingWarning")
@pytest.mark.parametrize("kind", PINGS)
def test_each_type_is_heard_as_it_is_read(
    kind: str, domain: int, tmp_path: Path, rng: np.random.Generator,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """A bag with the types of its drivers, played in another process: the map is that of `map`."""
    from insonify.live.bus import Bus
    from insonify.live.wiring import heard

    monkeypatch.setenv(PREFIXES, str(workspace(tmp_path / "ws", "sonar_oculus/msg/OculusPing",
                                               "other_driver/msg/Fan")))  # fmt: skip
    maker = BagMaker("mcap")
    told: list[tuple[str, float, Any]] = [
        ("/tf_static", 9.0, maker.link(9.0, "base_link", "sonar", np.zeros(3), LEVEL))
    ]
    for number in range(6):
        place = np.array([0.2 * number, 0.0, -2.0])
        told.append(("/odom", 10.0 + number, maker.odometry(10.0 + number, place, LEVEL)))
        if number < 5:
            image = rng.integers(0, 256, (BINS, BEAMS), dtype=np.uint8)
            time_s = 10.5 + number
            told.append(("/sonar", time_s, PINGS[kind](maker, time_s, image)))
    bag = maker.write(tmp_path / "bag", told)
    remap = map_recordings([open_recording(bag)], HOW.mapping)
    save_map(remap.mapper.voxels, tmp_path / "map.npz")
    line = [sys.executable, "-m", "insonify", "play", str(bag), "--rate", "5"]
    apart = {name: value for name, value in os.environ.items() if name != PREFIXES}
    monkeypatch.setattr("insonify.results.map._report", lambda remap, path: None)
    with subprocess.Popen(line, env=apart, stderr=subprocess.PIPE, text=True) as player:
        poser = Poser(Reading(), Counts())
        with Bus() as bus:
            publisher = Publisher([bus.publish])
            order = Order(HOW, None, tmp_path / "live")
            source = heard(bus, poser, publisher, 30.0)
            ended = threading.Event()

            def watch(session: Session, event: Event) -> None:
                if session.counts.mapped == 5:
                    ended.set()

            run_session(order, poser, source, [publisher.watch, watch], ended.is_set)
        _, said = player.communicate(timeout=60)
    assert player.returncode == 0 and "12 messages" in said, said
    assert (poser.counts.pings, poser.counts.mapped, poser.counts.damaged) == (5, 5, 0)
    assert (tmp_path / "live/map.npz").read_bytes() == (tmp_path / "map.npz").read_bytes()


def by_hand() -> dict[str, Any]:
    """Types written by hand, as rosidl names them; of a package that is not known here."""
    from cyclonedds.idl import make_idl_struct
    from cyclonedds.idl import types as idl
    from cyclonedds.idl.types import float32, float64, int16, int32, uint8, uint16, uint32

    sequence: Any = idl.sequence
    time_ = make_idl_struct(
        "Time_", "builtin_interfaces::msg::dds_::Time_", {"sec": int32, "nanosec": uint32}
    )
    header = make_idl_struct(
        "Header_", "std_msgs::msg::dds_::Header_", {"stamp": time_, "frame_id": str}
    )
    picture = make_idl_struct(
        "CompressedImage_", "sensor_msgs::msg::dds_::CompressedImage_",
        {"header": header, "format": str, "data": sequence[uint8]},
    )  # fmt: skip
    fire = make_idl_struct(
        "OculusFire_", "oculus_driver::msg::dds_::OculusFire_", {"mode": uint8, "gain": float64}
    )
    ping = make_idl_struct(
        "OculusPing_", "oculus_driver::msg::dds_::OculusPing_",
        {
            "header": header, "fire_msg": fire, "ping_id": uint32, "bearings": sequence[int16],
            "range_resolution": float64, "num_ranges": uint32, "num_beams": uint32, "ping": picture,
        },
    )  # fmt: skip
    stepped = make_idl_struct(
        "SonarEcho_", "ping360_sonar_msgs::msg::dds_::SonarEcho_",
        {
            "header": header, "angle": float32, "gain": uint8, "number_of_samples": uint16,
            "transmit_frequency": uint16, "speed_of_sound": uint16, "range": uint8,
            "step_size": uint8, "intensities": sequence[uint8],
        },
    )  # fmt: skip
    return {"time": time_, "header": header, "picture": picture, "fire": fire, "ping": ping,
            "echo": stepped}  # fmt: skip


FIRE = "uint8 mode   # 1 or 2\nfloat64 gain\n"
PING = (
    "std_msgs/Header header\n\nOculusFire fire_msg\nuint32 ping_id\nint16[] bearings # 0.01 deg\n"
    "float64 range_resolution\nuint32 num_ranges\nuint32 num_beams\n"
    "sensor_msgs/CompressedImage ping"
)


def written(domain: int, topic: str, kind: Any, *samples: Any) -> Iterator[Any]:
    """What a bus of ours hears of samples that a plain DDS program writes."""
    from cyclonedds.core import Policy, Qos
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.pub import DataWriter
    from cyclonedds.topic import Topic
    from cyclonedds.util import duration

    from insonify.live.bus import Bus
    from insonify.live.wiring import wanted_by

    participant = DomainParticipant(domain)
    quality = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(5))
    writer = DataWriter(participant, Topic(participant, f"rt{topic}", kind), qos=quality)
    wanted = wanted_by(Reading())
    with Bus() as bus:
        until = time.monotonic() + 20.0
        while not writer.get_matched_subscriptions():
            bus.poll(wanted, 0.05)
            assert time.monotonic() < until
        for sample in samples:
            writer.write(sample)
        while time.monotonic() < until:
            yield from bus.poll(wanted, 0.1)
        pytest.fail("it was not heard")


def test_a_drivers_type_is_found_in_its_workspace(
    domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    """And until the workspace is sourced it is refused, in a sentence."""
    types = by_hand()
    image = rng.integers(0, 256, (BINS, BEAMS), dtype=np.uint8)
    header = types["header"](types["time"](10, 5), "sonar")
    ping = types["ping"](
        header, types["fire"](2, 0.5), 7, [1400, -1400], 0.05, BINS, BEAMS,
        types["picture"](header, "png", bytes(png(image))),
    )  # fmt: skip
    monkeypatch.delenv(PREFIXES, raising=False)
    with pytest.raises(ConfigError, match=r"/ping has pings.*oculus_driver/msg/OculusPing.*source"):
        next(written(domain, "/ping", types["ping"], ping))
    share = tmp_path / "ws" / "share" / "oculus_driver" / "msg"
    share.mkdir(parents=True)
    (share / "OculusPing.msg").write_text(PING)
    monkeypatch.setenv(PREFIXES, f"{tmp_path / 'other'}{os.pathsep}{tmp_path / 'ws'}")
    assert fields_of("oculus_driver/msg/OculusPing") is None, "a type inside is not there"
    (share / "OculusFire.msg").write_text(FIRE)
    message = next(written(domain, "/ping", types["ping"], ping)).decode()
    assert (message.header.stamp.sec, message.header.frame_id) == (10, "sonar")
    assert (message.fire_msg.mode, message.fire_msg.gain, message.ping_id) == (2, 0.5, 7)
    assert message.bearings.tolist() == [1400, -1400]
    assert message.ping.data.tobytes() == png(image).tobytes()


@pytest.mark.parametrize("frame", ["", "a", "ab", "abc", "head"])
def test_echoes_with_a_step_are_read_as_those_without(frame: str) -> None:
    """The byte lies where CDR pads, so that both versions of the type are known at once."""
    pytest.importorskip("cyclonedds")
    types, kind = by_hand(), "ping360_sonar_msgs/msg/SonarEcho"
    fields = fields_of(kind)
    assert fields is not None and "step_size" not in fields
    header = types["header"](types["time"](10, 5), frame)
    sample = types["echo"](header, 0.25, 1, 3, 740, 1500, 2, 9, [1, 2, 3])
    message: Any = message_types().deserialize_cdr(sample.serialize(), kind)
    assert (
        message.header.frame_id == frame
        and message.angle == 0.25
        and message.range == 2
        and message.speed_of_sound == 1500
    )
    assert message.intensities.tolist() == [1, 2, 3]


def test_a_definition_that_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    share = tmp_path / "share" / "broken" / "msg"
    share.mkdir(parents=True)
    (share / "OculusPing.msg").write_text("float32[ x\n")
    monkeypatch.setenv(PREFIXES, str(tmp_path))
    with pytest.raises(ConfigError, match=r"OculusPing\.msg: is no definition"):
        fields_of("broken/msg/OculusPing")
