"""Bags as other programs write them: through plain rosbags, with definitions of their own."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from insonify.types import Array

KINDS = ("mcap", "db3", "ros1")
_DEFINITIONS = {
    "marine_acoustic_msgs/msg/PingInfo": "float32 frequency\nfloat32 sound_speed\n"
    "float32[] tx_beamwidths\nfloat32[] rx_beamwidths",
    "marine_acoustic_msgs/msg/SonarImageData": "bool is_bigendian\nuint32 dtype\n"
    "uint32 beam_count\nuint8[] data",
    "marine_acoustic_msgs/msg/ProjectedSonarImage": "std_msgs/Header header\n"
    "marine_acoustic_msgs/PingInfo ping_info\ngeometry_msgs/Vector3[] beam_directions\n"
    "float32[] ranges\nmarine_acoustic_msgs/SonarImageData image",
    "sonar_oculus/msg/OculusPing": "std_msgs/Header header\nuint32 ping_id\n"
    "float64 range_resolution\nuint32 num_ranges\nuint32 num_beams\nint16[] bearings\n"
    "sensor_msgs/CompressedImage ping",
    "other_driver/msg/Fan": "std_msgs/Header header\nuint32 num_ranges\n"
    "float32 range_resolution\nfloat32[] bearings\nsensor_msgs/Image ping",
    "ping360_sonar_msgs/msg/SonarEcho": "std_msgs/Header header\nfloat32 angle\nuint8 gain\n"
    "uint16 number_of_samples\nuint16 transmit_frequency\nuint16 speed_of_sound\nuint8 range\n"
    "uint8[] intensities",
}


def definitions_of(kind: str) -> str:
    """How the driver of a type defines it, ``pkg/msg/Name``."""
    return _DEFINITIONS[kind]


class BagMaker:
    """Messages of ROS 1 or 2, and bags of them."""

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self.store: Typestore = get_typestore(
            Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_JAZZY
        )
        types: Any = {}
        definitions = dict(_DEFINITIONS)
        if kind == "ros1":  # not among rosbags' own
            definitions["tf2_msgs/msg/TFMessage"] = "geometry_msgs/TransformStamped[] transforms"
        for name, text in definitions.items():
            types |= get_types_from_msg(text, name)
        self.store.register(types)

    def new(self, kind: str, /, **fields: Any) -> Any:
        package, short = kind.split("/")
        return self.store.types[f"{package}/msg/{short}"](**fields)

    def header(self, time_s: float, frame: str) -> Any:
        sec, nanosec = divmod(round(time_s * 1e9), 10**9)
        stamp = self.new("builtin_interfaces/Time", sec=sec, nanosec=nanosec)
        more = {"seq": 0} if self.kind == "ros1" else {}
        return self.new("std_msgs/Header", stamp=stamp, frame_id=frame, **more)

    def vector(self, x: float, y: float, z: float) -> Any:
        return self.new("geometry_msgs/Vector3", x=float(x), y=float(y), z=float(z))

    def turn(self, quaternion: Iterable[float]) -> Any:
        x, y, z, w = map(float, quaternion)
        return self.new("geometry_msgs/Quaternion", x=x, y=y, z=z, w=w)

    def projected(
        self,
        time_s: float,
        image: Array,
        azimuths: Array,
        ranges: Array,
        elevation: float,
        frame: str = "sonar",
    ) -> Any:
        """An image (bins, beams) of uint8 or uint16, in the order of the azimuths given."""
        return self.new(
            "marine_acoustic_msgs/ProjectedSonarImage",
            header=self.header(time_s, frame),
            ping_info=self.new(
                "marine_acoustic_msgs/PingInfo", frequency=1e6, sound_speed=1500.0,
                tx_beamwidths=np.full(len(azimuths), elevation, np.float32),
                rx_beamwidths=np.zeros(0, np.float32),
            ),
            beam_directions=[self.vector(0.0, -np.sin(a), np.cos(a)) for a in azimuths],
            ranges=ranges.astype(np.float32),
            image=self.new(
                "marine_acoustic_msgs/SonarImageData", is_bigendian=False,
                dtype={"u1": 0, "u2": 2}[image.dtype.str[1:]], beam_count=image.shape[1],
                data=np.ascontiguousarray(image).reshape(-1).view(np.uint8),
            ),
        )  # fmt: skip

    def posed(self, time_s: float, position: Array) -> Any:
        """A level PoseStamped."""
        x, y, z = position.tolist()
        point = self.new("geometry_msgs/Point", x=x, y=y, z=z)
        level = self.turn(np.array([0.0, 0.0, 0.0, 1.0]))
        pose = self.new("geometry_msgs/Pose", position=point, orientation=level)
        return self.new("geometry_msgs/PoseStamped", header=self.header(time_s, "map"), pose=pose)

    def odometry(
        self, time_s: float, position: Array, quaternion: Array, child: str = "base_link"
    ) -> Any:
        x, y, z = position.tolist()
        point = self.new("geometry_msgs/Point", x=x, y=y, z=z)
        pose = self.new("geometry_msgs/Pose", position=point,
                        orientation=self.turn(quaternion))  # fmt: skip
        zero = self.new("geometry_msgs/Twist", linear=self.vector(0, 0, 0),
                        angular=self.vector(0, 0, 0))  # fmt: skip
        return self.new(
            "nav_msgs/Odometry",
            header=self.header(time_s, "odom"),
            child_frame_id=child,
            pose=self.new("geometry_msgs/PoseWithCovariance", pose=pose, covariance=np.zeros(36)),
            twist=self.new("geometry_msgs/TwistWithCovariance", twist=zero,
                           covariance=np.zeros(36)),
        )  # fmt: skip

    def link(
        self, time_s: float, parent: str, child: str, position: Array, quaternion: Array
    ) -> Any:
        transform = self.new("geometry_msgs/Transform", translation=self.vector(*position),
                             rotation=self.turn(quaternion))  # fmt: skip
        stamped = self.new("geometry_msgs/TransformStamped", header=self.header(time_s, parent),
                           child_frame_id=child, transform=transform)  # fmt: skip
        return self.new("tf2_msgs/TFMessage", transforms=[stamped])

    def write(self, path: Path, messages: list[tuple[str, float, Any]]) -> Path:
        """A bag of (topic, time, message); returns the file, or the folder of a ROS 2 bag."""
        if self.kind == "ros1":
            with Writer1(path.with_suffix(".bag")) as one:
                self._fill(one, messages, ros1=True)
            return path.with_suffix(".bag")
        plugin = StoragePlugin.MCAP if self.kind == "mcap" else StoragePlugin.SQLITE3
        with Writer2(path, version=9, storage_plugin=plugin) as two:
            self._fill(two, messages, ros1=False)
        return path / f"{path.name}.mcap" if self.kind == "mcap" else path

    def _fill(self, writer: Any, messages: list[tuple[str, float, Any]], ros1: bool) -> None:
        connections: dict[str, Any] = {}
        for topic, time_s, message in messages:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=self.store)
            serialise = self.store.serialize_ros1 if ros1 else self.store.serialize_cdr
            writer.write(connections[topic], round(time_s * 1e9), serialise(message, kind))


def plain_bag(path: Path, kind: str, rng: np.random.Generator, pings: int = 4) -> Path:
    """A few pings with odometry and a mount in TF."""
    maker = BagMaker(kind)
    azimuths = np.radians(np.linspace(14.0, -14.0, 8))
    ranges = 0.5 + 0.05 * np.arange(20)
    level = np.array([0.0, 0.0, 0.0, 1.0])
    messages: list[tuple[str, float, Any]] = [
        ("/tf_static", 9.0, maker.link(9.0, "base_link", "sonar", np.zeros(3),
                                       np.array([0.5, 0.5, 0.5, 0.5])))
    ]  # fmt: skip
    for number in range(pings + 1):
        time_s = 10.0 + number
        messages.append(
            ("/odom", time_s, maker.odometry(time_s, np.array([number, 0.0, -2.0]), level))
        )
        if number < pings:
            image = rng.integers(0, 256, (20, 8), dtype=np.uint8)
            ping = maker.projected(time_s + 0.5, image, azimuths, ranges, 0.2)
            messages.append(("/sonar", time_s + 0.5, ping))
    return maker.write(path, messages)
