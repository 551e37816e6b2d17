"""A ROS bag as a recording: its pings, and the poses of the vehicle at their times."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from typing import Any

from insonify.errors import RecordingError, reason
from insonify.io.recordings.beams import PixelError, unit_pixels
from insonify.io.recordings.recording import (
    Reading,
    Recording,
    RecordingWarning,
    corrected,
    refuse_beams,
    scaled,
)
from insonify.io.recordings.ros.bags import DAMAGE, Bag, BagMessage
from insonify.io.recordings.ros.frame_tree import stamp_ns
from insonify.io.recordings.ros.index import Index, index_of, namespace
from insonify.io.recordings.ros.messages import geometry_from_state, poses_from_state
from insonify.io.recordings.ros.pings import PingDecoder
from insonify.io.recordings.ros.whereabouts import Whereabouts, whereabouts
from insonify.types import Array, Ping, PosedPing


def read_bag(bag: Bag, reading: Reading) -> Recording:
    """Open a bag as a recording.

    Raises:
        RecordingError: There are no pings in it that can be read, or not on the topic asked for.
    """
    index = index_of(bag, reading.max_gap_s)
    if bag.cut and index.sonars:
        warnings.warn(
            f"{bag.path}: damaged or cut off ({bag.cut}); what lies before is read",
            RecordingWarning,
            stacklevel=2,
        )
    topic = sonar_topic(bag, index, reading)
    index.settle(namespace(topic))
    poses = whereabouts(bag, index, topic, reading)
    count = sum(n for (name, _), n in index.counts.items() if name == topic)
    reading, scale_doubts = scaled_pixels(bag, index, topic, reading)
    decoder = PingDecoder(
        index.sonars[topic], poses.mount, reading, framed=poses.framed, ours=bool(index.states)
    )

    def read() -> Iterator[PosedPing]:
        broken, why = 0, ""
        for message in bag.read({topic}):
            try:
                yield posed_ping(message, decoder, index, poses, reading)
            except PixelError:
                raise  # it is the user's to say what they mean
            except DAMAGE as err:
                broken, why = broken + 1, reason(err)
        if broken:
            warnings.warn(
                f"{bag.path}: {broken} messages of {topic} are no pings and left out ({why})",
                RecordingWarning,
                stacklevel=2,
            )

    first = _first(read())  # so that the decoder knows what it has to assume
    if first is not None and first.ping.geometry.beams == 1:
        refuse_beams(bag.path, reading)
    facts = _facts(index, topic, poses, decoder)
    facts["doubts"] += scale_doubts
    return Recording(bag.path, bag.format, count, True, facts, read, poses.exact)


def _facts(index: Index, topic: str, poses: Whereabouts, decoder: PingDecoder) -> dict[str, Any]:
    facts: dict[str, Any] = {
        "topics": {f"{name} ({kind})": n for (name, kind), n in sorted(index.counts.items())},
        "sonar_topic": topic,
        "sonar_frame": index.frames.get(topic, ""),
        "mount": poses.mount_source,
        "beams": decoder.axes,
        "columns": decoder.columns or decoder.reading.columns(port_first=True),
        "poses": poses.source,
        "doubts": [*poses.doubts, *decoder.doubts],
    }
    if index.undecoded:
        facts["messages_not_decoded"] = index.undecoded
    if poses.track is not None:
        facts["max_gap_s"] = poses.track.max_gap_s
    return facts


def _first(pings: Iterator[PosedPing]) -> PosedPing | None:
    """The first ping; None if there is none, or its pixels cannot be meant, which reading tells."""
    try:
        return next(pings, None)
    except PixelError:
        return None


def scaled_pixels(
    bag: Bag, index: Index, topic: str, reading: Reading
) -> tuple[Reading, list[str]]:
    """The full scale of the pings' pixels, as `scaled` finds it."""
    decoder = PingDecoder(index.sonars[topic], None, reading)

    def raw() -> Iterator[Array]:
        for message in bag.read({topic}):
            try:
                yield decoder.raw(message.decode())
            except DAMAGE:
                continue

    first = next(raw(), None)
    if first is None:
        return reading, []
    return scaled(reading, first.dtype, lambda: max(int(pixels.max()) for pixels in raw()))


def posed_ping(
    message: BagMessage, decoder: PingDecoder, index: Index, poses: Whereabouts, reading: Reading
) -> PosedPing:
    """A message as a ping with the pose that is known of its time.

    Raises:
        PixelError: Its pixels cannot be meant as they stand.
        Exception: One of `DAMAGE`: it is no ping.
    """
    decoded = message.decode()
    time_ns = stamp_ns(decoded.header) or message.time_ns
    time_s = time_ns * 1e-9
    state = index.states.get(time_ns) if poses.exact else None
    if state is not None:
        geometry = geometry_from_state(state)
        pixels = decoder.pixels(decoded)
        if pixels.shape != (geometry.bins, geometry.beams):
            raise ValueError(f"a state of {geometry.bins} x {geometry.beams} pixels is not its own")
        image = unit_pixels(pixels, reading.full_scale, unknown=True)
        pose, truth = poses_from_state(state)
        return corrected(PosedPing(Ping(image, geometry, time_s), pose, truth), reading)
    at_s = time_s + reading.clock_offset_s
    mount = poses.mount
    if poses.base:
        mount = index.tree.between(poses.base, str(decoded.header.frame_id), at_s)
        if mount is None:
            return PosedPing(decoder.ping(decoded, time_s))
        mount = mount if poses.turn is None else poses.turn @ mount
    decoder.sit(mount)
    return PosedPing(decoder.ping(decoded, time_s), poses.pose(index, at_s))


def sonar_topic(bag: Bag, index: Index, reading: Reading) -> str:
    """The topic of the pings.

    Raises:
        RecordingError: There is none, or several and the user does not say which.
    """
    wanted = reading.sonar_topic
    if wanted is not None and wanted in index.sonars:
        return wanted
    if wanted is None and len(index.sonars) == 1:
        return next(iter(index.sonars))
    if wanted is None and index.sonars:
        named = ", ".join(sorted(index.sonars))
        raise RecordingError(f"{bag.path}: more than one sonar; say which (--sonar-topic): {named}")
    if bag.cut and not index.sonars:
        raise RecordingError(f"{bag.path}: damaged or cut off before its first ping ({bag.cut})")
    topics = ", ".join(f"{name} ({kind})" for name, kind in sorted(index.counts)) or "none"
    what = "no pings" if wanted is None else f"no pings on {wanted}"
    raise RecordingError(
        f"{bag.path}: {what} (ProjectedSonarImage, OculusPing or SonarEcho); its topics: {topics}"
    )
