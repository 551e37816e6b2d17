"""Recordings played through a live session: the same map as `map` makes of them, byte for byte."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks import samples
from benchmarks.bag_samples import KINDS, BagMaker, plain_bag

from insonify.errors import RecordingError
from insonify.io.maps import load_map, ondisk, save_map
from insonify.io.recordings import open_recording
from insonify.io.recordings.recording import Reading, RecordingWarning
from insonify.io.recordings.ros import messages
from insonify.io.recordings.ros.bags import BagMessage
from insonify.live import keeping
from insonify.live import session as session_module
from insonify.live.counts import Counts
from insonify.live.played import as_message, open_played, paced
from insonify.live.poser import MOST_WAITING, Patience, Poser
from insonify.live.running import Order, run_session
from insonify.mapping.factory import make_mapper
from insonify.mapping.mapper import MappingSettings
from insonify.mission.remap import map_ping, map_recordings
from insonify.results.map import MapConfig
from insonify.types import FanGeometry, Ping, Pose, PosedPing

DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "recordings"
FAN = FanGeometry(0.7, 0.2, 8, 16, 0.2, 2.0)
START_NS = 10_000_000_000
FINE = MapConfig(mapping=MappingSettings(voxel_m=0.1, pixel_threshold=120))
COARSE = MapConfig(mapping=MappingSettings(voxel_m=0.5))


@pytest.fixture(autouse=True)
def no_reports(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    if "run" not in request.fixturenames:  # they take longer than all else
        monkeypatch.setattr("insonify.results.map._report", lambda remap, path: None)


def mapped(
    path: Path, recordings: list[Path], reading: Reading = Reading(), config: MapConfig = FINE
) -> bytes:
    """The map file that `map` makes of recordings."""
    remap = map_recordings([open_recording(one, reading) for one in recordings], config.mapping)
    save_map(remap.mapper.voxels, path)
    return path.read_bytes()


def lived(
    folder: Path,
    source: Iterator[BagMessage | None],
    poser: Poser,
    job: str = "",
    config: MapConfig = FINE,
    memory_bytes: int | None = None,
) -> tuple[bytes, Counts]:
    """The map file that a session leaves, and what happened to messages."""
    order = Order(config, None, folder, memory_bytes=memory_bytes, job=job)
    _, place = run_session(order, poser, source)
    file = place / "map.npz"
    if (place / "map.zarr").is_dir():
        save_map(load_map(place / "map.zarr"), file)
    return (file.read_bytes() if file.is_file() else b""), poser.counts


def check_played(
    tmp_path: Path, path: Path, reading: Reading = Reading(), config: MapConfig = FINE
) -> Counts:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordingWarning)
        played = open_played(path, reading)
        poser = played.poser(Counts())
        live, counts = lived(
            tmp_path / "live", paced(played.messages(), None), poser, config=config
        )
        assert live == mapped(tmp_path / "map.npz", [path], reading, config)
        parts = sorted((tmp_path / "live" / "recordings").iterdir())
        assert live == mapped(tmp_path / "again.npz", parts, config=config)
    assert counts.mapped > 0
    return counts


@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_of_others(kind: str, tmp_path: Path, rng: np.random.Generator) -> None:
    counts = check_played(tmp_path, plain_bag(tmp_path / "bag", kind, rng))
    assert (counts.pings, counts.mapped, counts.poses) == (4, 4, 5)


SHARED: dict[str, int] = {
    "holoocean_turtle.npz": 0,
    "oculus_one_ping_8bit.raw": 1,
    "oculus_three_pings_8bit.raw": 3,
    "sample.aris": 0,
    "wl3d15_ship_short.sonar": 0,
}
"""Recordings, and how many poses one without a clock needs."""


@pytest.mark.slow
@pytest.mark.parametrize("name", SHARED)
def test_shared_recordings(name: str, tmp_path: Path) -> None:
    path = DATA / name
    if not path.is_file():
        pytest.skip(f"{path} is not there")
    reading = Reading()
    if not name.endswith(".npz"):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RecordingWarning)
            times = [posed.ping.time_s for posed in open_recording(path)]
        rows = samples.tum_rows(SHARED[name] or 9)
        if not SHARED[name]:
            rows[:, 0] = np.linspace(times[0] - 0.1, times[-1] + 0.1, len(rows))
        np.savetxt(tmp_path / "poses.tum", rows, fmt="%.9f")
        reading = Reading(poses=tmp_path / "poses.tum")
    check_played(tmp_path, path, reading, COARSE)


def robot(count: int = 12, odometry_hz: float = 10.0) -> list[BagMessage]:
    """A vehicle whose odometry lies between its pings, a head that turns, a mount in TF."""
    rng = np.random.default_rng(3)
    mount = messages.transforms([("base_link", "head", np.eye(4))], 0)
    told: list[BagMessage] = [as_message("/tf_static", mount, START_NS)]
    for k in range(round(0.3 * count * odometry_hz) + 3):
        now = START_NS + round(k / odometry_hz * 1e9)
        pose = Pose(0.2 * k / odometry_hz, 0.01 * k, -3.0, yaw_rad=0.02 * k)
        told.append(as_message("/odometry", messages.odometry(pose, now, "odom"), now))
        turn = np.eye(4)
        turn[:3, 3] = 0.001 * k, 0.0, -0.1
        link = messages.transforms([("head", "sonar", turn @ messages.IMAGE_FROM_SONAR)], now)
        told.append(as_message("/tf", link, now))
    for k in range(count):
        now = START_NS + round((0.13 + 0.3 * k) * 1e9)
        image = (rng.random((16, 8)) > 0.8).astype(np.float32)
        ping = messages.sonar_image(Ping(image, FAN), now, "sonar", 1e6, 1500.0)
        told.append(as_message("/sonar/image", ping, now))
    return sorted(told, key=lambda one: one.time_ns)


def bag_of(path: Path, told: list[BagMessage]) -> Path:
    from insonify.io.recordings.ros.mcap_writing import McapWriter

    with McapWriter(path) as writer:
        for one in told:
            writer.write(one.topic, one.decode(), one.time_ns)
    return path


def later(one: BagMessage, by_s: float) -> BagMessage:
    return replace(one, time_ns=one.time_ns + round(by_s * 1e9))


def heard(tmp_path: Path, told: list[BagMessage], **more: Any) -> tuple[bytes, Counts]:
    poser = Poser(Reading(), Counts(), patience=Patience(**more))
    return lived(tmp_path / "live", iter(told), poser)


def test_a_recording_that_is_played_slowly(tmp_path: Path) -> None:
    """Moments without a message, of which each may be long, are none of the recording's time."""
    path = bag_of(tmp_path / "bag.mcap", robot())
    played = open_played(path, Reading())
    slowly: Iterator[BagMessage | None] = (
        one
        for message in played.messages()
        for one in ((message, None) if "sonar" in message.topic else (message,))
    )
    live, counts = lived(tmp_path / "live", slowly, played.poser(Counts()))
    assert live == mapped(tmp_path / "map.npz", [path])
    assert counts.mapped == 12 and not counts.unposed


def test_a_turning_head_and_poses_between_pings(tmp_path: Path) -> None:
    """Without having read it through, as on a bus, and beforehand, as a bag."""
    path = bag_of(tmp_path / "bag.mcap", robot())
    counts = check_played(tmp_path, path)
    assert (counts.pings, counts.mapped) == (12, 12)
    (tmp_path / "bus").mkdir()
    live, counts = heard(tmp_path / "bus", robot())
    assert live == mapped(tmp_path / "map.npz", [path])
    assert counts.mapped == 12 and not counts.unposed


def test_poses_that_come_after_their_pings(tmp_path: Path) -> None:
    whole = mapped(tmp_path / "map.npz", [bag_of(tmp_path / "bag.mcap", robot())])
    slow = [later(one, 0.6 * (one.topic != "/sonar/image")) for one in robot()]
    live, counts = heard(tmp_path, sorted(slow, key=lambda one: one.time_ns))
    assert live == whole and counts.mapped == 12 and not counts.late_poses


def test_a_ping_whose_pose_never_comes_leaves_without(tmp_path: Path) -> None:
    told = [
        one for one in robot() if "sonar" in one.topic or one.time_ns < START_NS + 2_000_000_000
    ]
    live, counts = heard(tmp_path, told)
    assert live and 0 < counts.mapped < 12 and counts.mapped + counts.unposed == 12
    parts = sorted((tmp_path / "live" / "recordings").iterdir())
    with pytest.warns(RecordingWarning, match="have no pose at their time"):
        assert live == mapped(tmp_path / "again.npz", parts)


def test_pings_that_come_twice_or_late(tmp_path: Path) -> None:
    told = robot()
    pings = [number for number, one in enumerate(told) if one.topic == "/sonar/image"]
    whole = mapped(tmp_path / "map.npz", [bag_of(tmp_path / "bag.mcap", told)])
    doubled = [copy for one in told for copy in [one] * (1 + (one.topic == "/sonar/image"))]
    live, counts = heard(tmp_path, doubled)
    assert live == whole and counts.duplicates == 12
    told[pings[3]], told[pings[5]] = told[pings[5]], told[pings[3]]
    live, counts = heard(tmp_path / "swapped", told)
    assert counts.out_of_order > 0 and counts.mapped == 12
    parts = sorted((tmp_path / "swapped" / "live" / "recordings").iterdir())
    assert live == mapped(tmp_path / "again.npz", parts)


def test_a_gap_in_the_poses(tmp_path: Path) -> None:
    """A bus that was away for 10 s: what is between is told from a pose by neither side."""
    before, after = robot(), [later_all(one, 20.0) for one in robot()]
    stray = later_all(next(one for one in robot() if one.topic == "/sonar/image"), 10.0)
    live, counts = heard(tmp_path, [*before, stray, *after])
    assert counts.mapped == 24 and counts.unposed == 1
    bag = bag_of(tmp_path / "bag.mcap", [*before, stray, *after])
    with pytest.warns(RecordingWarning, match="1 of 25 pings have no pose"):
        assert live == mapped(tmp_path / "map.npz", [bag])


def later_all(one: BagMessage, by_s: float) -> BagMessage:
    """A message that is stamped and comes later."""
    import copy

    message = copy.deepcopy(one.decode())
    shift = round(by_s * 1e9)
    for header in [getattr(message, "header", None), *[t.header for t in
                   getattr(message, "transforms", [])]]:  # fmt: skip
        if header is not None:
            now = header.stamp.sec * 10**9 + header.stamp.nanosec + shift
            header.stamp.sec, header.stamp.nanosec = divmod(now, 10**9)
    return BagMessage(one.topic, one.kind, one.time_ns + shift, lambda: message)


def test_a_clock_that_is_set_back(tmp_path: Path) -> None:
    """The robot was started anew: its poses of before are no poses of now."""
    first = [later_all(one, 1000.0) for one in robot()]
    again = [replace(one, time_ns=one.time_ns + 1_010_000_000_000) for one in robot()]
    _, counts = heard(tmp_path, [*first, *again])
    assert counts.clock_resets == 1 and counts.mapped >= 22


def test_messages_that_are_none(tmp_path: Path) -> None:
    def broken() -> Any:
        raise ValueError("cut off")

    told = robot()
    at = [number for number, one in enumerate(told) if one.topic == "/sonar/image"]
    told[at[4]] = replace(told[at[4]], decode=broken)
    short = messages.sonar_image(Ping(np.zeros((16, 8), np.float32), FAN), 1, "sonar", 1.0, 1.0)
    short.image.data = short.image.data[:-4]
    told.append(as_message("/sonar/image", short, told[-1].time_ns))
    _, counts = heard(tmp_path, told)
    assert counts.damaged == 2 and counts.mapped == 11
    assert "are not 16 ranges" in counts.last_damage


def test_memory_is_bounded_without_any_pose(tmp_path: Path) -> None:
    poser = Poser(Reading(), Counts(), patience=Patience(listen_s=1e9, wait_s=1e9))
    pings = [one for one in robot(MOST_WAITING + 20) if one.topic == "/sonar/image"]
    left = [posed for one in pings for _, posed in poser.take(one)]
    assert poser.waiting == MOST_WAITING and len(left) == 20
    assert all(posed.pose is None for posed in left)


def test_a_long_way_is_thinned_and_as_long(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    heard(tmp_path, robot())
    monkeypatch.setattr(session_module, "MOST_POSES", 5)
    (tmp_path / "again").mkdir()
    heard(tmp_path / "again", robot())
    results = [
        json.loads((folder / "live/result.json").read_text())
        for folder in (tmp_path, tmp_path / "again")
    ]
    assert results[0]["pings"] == results[1]["pings"] == 12
    assert results[0]["path_m"] == results[1]["path_m"] > 0.5


def test_what_is_the_users_to_say_is_asked(tmp_path: Path) -> None:
    two = [
        replace(one, topic=f"/{side}{one.topic}") for one in robot() for side in ("left", "right")
    ]
    with pytest.raises(RecordingError, match=r"more than one sonar.*--sonar-topic"):
        heard(tmp_path, two)
    assert not list(tmp_path.iterdir())
    maker = BagMaker("mcap")
    wide = maker.projected(10.05, np.full((16, 8), 700, np.uint16), np.linspace(0.3, -0.3, 8),
                           0.2 + 0.1 * np.arange(16), 0.2)  # fmt: skip
    told = [one for one in robot() if one.topic != "/sonar/image"]
    told.insert(8, as_message("/sonar/image", wide, START_NS + 100_000_000))
    with pytest.raises(RecordingError, match=r"pixels are uint16.*--scale"):
        heard(tmp_path, told)


def test_a_session_that_was_broken_off_is_gone_on_with(tmp_path: Path) -> None:
    """As a kill leaves it: what was recorded stays, and the next start has the map of both."""

    class Gone(BaseException):
        pass

    def dies(told: list[BagMessage]) -> Iterator[BagMessage]:
        yield from told
        raise Gone

    told = robot(24)
    with pytest.raises(Gone):
        lived(tmp_path / "live", dies(told[:60]), Poser(Reading(), Counts()), job="job")
    with pytest.raises(Gone):  # nothing is heard in between
        lived(tmp_path / "live", dies([]), Poser(Reading(), Counts()), job="job")
    assert not (tmp_path / "live").exists()
    live, counts = lived(tmp_path / "live", iter(told[60:]), Poser(Reading(), Counts()), job="job")
    parts = sorted((tmp_path / "live" / "recordings").iterdir())
    assert [part.name for part in parts] == ["001.mcap", "002.mcap"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordingWarning)
        assert live == mapped(tmp_path / "again.npz", parts)
    result = json.loads((tmp_path / "live" / "result.json").read_text())
    assert result["pings"] > counts.mapped > 0
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == []


@pytest.mark.parametrize(
    ("mapper", "memory_bytes"), [("bayes", None), ("carving", None), ("bayes", 1300 * 2560)]
)
def test_a_checkpoint_saves_mapping_again(
    mapper: str, memory_bytes: int | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same map, with fewer pings mapped twice; also of a map that is on disk."""

    class Gone(BaseException):
        pass

    def dies(told: list[BagMessage]) -> Iterator[BagMessage]:
        yield from told
        raise Gone

    voxel_m = 0.1 if memory_bytes is None else 0.02
    mapping = FINE.mapping.model_copy(update={"voxel_m": voxel_m})
    config = MapConfig(mapper=mapper, mapping=mapping)
    told = robot(24)
    again: list[str] = []

    def counted(*words: Any) -> PosedPing:
        again.append("again")
        return map_ping(*words)

    monkeypatch.setattr(keeping, "FLUSH_S", 0.0)
    monkeypatch.setattr(keeping, "_LEAST_S", 0.0)
    monkeypatch.setattr(keeping, "_SHARE", 1e9)
    monkeypatch.setattr(session_module, "TICK_S", 0.0)
    monkeypatch.setattr(keeping, "map_ping", counted)
    monkeypatch.setattr(ondisk, "LEAST_BYTES", 0)
    how: dict[str, Any] = {"job": "job", "config": config, "memory_bytes": memory_bytes}
    with pytest.raises(Gone):
        poser = Poser(Reading(), Counts())
        lived(tmp_path / "live", dies(told[:120]), poser, **how)
    before = poser.counts.mapped
    poser = Poser(Reading(), Counts())
    live, counts = lived(tmp_path / "live", iter(told[120:]), poser, **how)
    assert before > 4 and len(again) < before and counts.mapped > 0
    recordings = [open_recording(part) for part in sorted((tmp_path / "live/recordings").iterdir())]
    remap = map_recordings(recordings, config.mapping, mapper=make_mapper(mapper, config.mapping))
    save_map(remap.mapper.voxels, tmp_path / "again.npz")
    assert live == (tmp_path / "again.npz").read_bytes()
    if memory_bytes is not None:
        assert not list((tmp_path / "live/map.zarr").glob("*.npz*"))
    result = json.loads((tmp_path / "live/result.json").read_text())
    assert result["pings"] == before + counts.mapped and result["mapper"] == mapper


def test_the_command(tmp_path: Path, run: Callable[..., str], rng: np.random.Generator) -> None:
    plain_bag(tmp_path / "bag", "mcap", rng)
    bag, voxel = "bag/bag.mcap", ["--voxel", "0.1"]
    told = run("live", "--from", bag, "--rate", "50", *voxel, "--out", "L", code=0)
    assert "Report: L/report.html" in told
    run("map", bag, *voxel, "--out", "M", code=0)
    run("map", "L/recordings/001.mcap", *voxel, "--out", "N", code=0)
    live = (tmp_path / "L/map.npz").read_bytes()
    assert live == (tmp_path / "M/map.npz").read_bytes() == (tmp_path / "N/map.npz").read_bytes()
    account = json.loads((tmp_path / "L/live.json").read_text())
    assert account["pings"] == account["mapped"] == 4 and "on /odom" in account["poses_from"]
    assert "already exists" in run("live", "--from", bag, "--out", "L")
    assert "--rate takes a factor" in run("live", "--rate", "2")
    assert "there is no such recording" in run("live", "--from", "nowhere.mcap", "--out", "X")
