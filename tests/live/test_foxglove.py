"""Foxglove's protocol, spoken by a plain WebSocket client."""

from __future__ import annotations

import json
import socket
import struct
import time
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from insonify.errors import ConfigError
from insonify.io.recordings.recording import Reading
from insonify.io.recordings.ros import messages
from insonify.live.counts import Counts
from insonify.live.poser import Poser
from insonify.live.session import Heard, Session
from insonify.mapping.factory import make_mapper
from insonify.mapping.mapper import MappingSettings
from insonify.mission.remap import Remap
from insonify.types import FanGeometry, Ping, Pose, PosedPing

pytest.importorskip("foxglove")
client = pytest.importorskip("websockets.sync.client")


def advertised(connection: Any, topics: set[str]) -> dict[str, dict[str, Any]]:
    """The channels of some topics, as the server advertises them."""
    found: dict[str, dict[str, Any]] = {}
    while not topics <= set(found):
        text = connection.recv(timeout=20)
        if isinstance(text, str):
            told = json.loads(text)
            if told["op"] == "advertise":
                found |= {channel["topic"]: channel for channel in told["channels"]}
    return found


def test_a_client_subscribes_and_decodes_what_it_is_sent(rng: np.random.Generator) -> None:
    """By the definition that the server sends, with types of its own."""
    from insonify.live.foxglove import FoxgloveServer

    settings = MappingSettings()
    remap = Remap(settings, make_mapper("bayes", settings))
    session = Session(Poser(Reading(), Counts()), remap)
    ping = Ping(rng.random((20, 8), dtype=np.float32), FanGeometry(1.0, 0.2, 8, 20, 0.2, 5.0))
    heard = Heard(PosedPing(ping, Pose(1.0, 2.0, -3.0, yaw_rad=0.5)), 7_000_000_001)
    path = messages.path((Pose(4.0, 5.0, -6.0),), 9, "map")
    server = FoxgloveServer(port=0)
    assert server.url.startswith("ws://127.0.0.1:")
    try:
        protocols = ["foxglove.sdk.v1", "foxglove.websocket.v1"]
        with client.connect(server.url, subprotocols=protocols, max_size=None) as connection:
            server.send("/insonify/path", path)
            server.watch(session, heard)
            wanted = {"/insonify/path", "/sonar/polar", "/odometry", "/tf"}
            channels = advertised(connection, wanted)
            subscriptions = [
                {"id": number, "channelId": channels[topic]["id"]}
                for number, topic in enumerate(sorted(wanted))
            ]
            connection.send(json.dumps({"op": "subscribe", "subscriptions": subscriptions}))
            got: dict[str, Any] = {}
            until = time.monotonic() + 20.0
            while set(got) != wanted and time.monotonic() < until:
                server.send("/insonify/path", path)
                server.watch(session, heard)
                try:
                    data = connection.recv(timeout=0.2)
                except TimeoutError:  # what is sent before it is subscribed to is gone
                    continue
                if isinstance(data, bytes) and data[0] == 1:
                    number, _ = struct.unpack("<IQ", data[1:13])
                    topic = sorted(wanted)[number]
                    got[topic] = decode(channels[topic], data[13:])
    finally:
        server.close()
    assert got["/insonify/path"].poses[0].pose.position.z == -6.0
    assert got["/odometry"].pose.pose.position.y == 2.0
    assert got["/odometry"].header.stamp.nanosec == 1
    grey = got["/sonar/polar"].data.reshape(20, 8)
    np.testing.assert_array_equal(grey, np.round(ping.image[::-1] * 255.0).astype(np.uint8))


def decode(channel: dict[str, Any], data: bytes) -> Any:
    assert (channel["encoding"], channel["schemaEncoding"]) == ("cdr", "ros2msg")
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(channel["schema"], channel["schemaName"]))
    return store.deserialize_cdr(data, channel["schemaName"])


def test_a_port_that_is_taken() -> None:
    from insonify.live.foxglove import FoxgloveServer

    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(ConfigError, match=rf"127\.0\.0\.1:{port}.*--port"):
            FoxgloveServer(port=port)
