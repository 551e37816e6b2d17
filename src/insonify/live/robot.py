"""The simulated vehicle on the bus: hardware in the loop, without the hardware.

It publishes what its recordings hold, in real time, and flies the paths that come.  Its first scan
or tour is its own order's; after it and after each path it takes the one that was decided on its
last ping, asks for one if none comes, and ends when a path has no poses.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from insonify.errors import ConfigError
from insonify.frames import pose_from_quaternion, transform_from_pose
from insonify.imaging.tour import TourPing
from insonify.io.recordings.ros import messages
from insonify.io.recordings.ros.frame_tree import pose_row, stamp_ns
from insonify.live.bus import Bus
from insonify.live.played import PING_TOPICS, SONAR, SOUND_SPEED_MPS, ping_topics
from insonify.live.publishing import PATH, REQUEST
from insonify.live.wiring import await_listener
from insonify.mapping.mapper import Belief
from insonify.mission.loop import Pinged, Step
from insonify.mission.run import Run
from insonify.planning.baselines import path_over_centre
from insonify.planning.decision import Decision, SurveyArea
from insonify.results.recorder import (
    DVL,
    ESTIMATE,
    IMU,
    OCCUPIED,
    PLANS,
    TRUTH,
    ScanRecorder,
    believed_odometry,
    reading_messages,
)
from insonify.results.replay import posed_messages
from insonify.types import Nav, Pose, ScanPath, StopReason
from insonify.vehicle.craft import Craft
from insonify.vehicle.settings import VehicleSettings

CLOCK = "/clock"
VEHICLE_TOPICS = {
    "/tf_static": "tf2_msgs/msg/TFMessage",
    IMU: "sensor_msgs/msg/Imu",
    DVL: "marine_acoustic_msgs/msg/Dvl",
    CLOCK: "rosgraph_msgs/msg/Clock",
    REQUEST: "std_msgs/msg/String",
}
"""What a vehicle publishes besides its pings."""
_OWN = {OCCUPIED, PLANS}
"""What its recordings hold besides, and whoever maps must not see."""
LISTEN_S, ANSWER_S, ASK_S = 60.0, 60.0, 3.0
"""How long is waited for someone to listen, for a path, and before asking for one again."""
_BEHIND_S = 0.5
_STEP_NS = 100_000_000


class RealTime:
    """Waits until a time has come; where it is late, as after a wait for a path, it begins anew."""

    def __init__(self) -> None:
        """Not begun."""
        self._begun_s: float | None = None

    def __call__(self, time_s: float) -> None:
        """Wait for a time of the vehicle's clock."""
        now_s = time.monotonic()
        if self._begun_s is None or now_s - self._begun_s - time_s > _BEHIND_S:
            self._begun_s = now_s - time_s
        time.sleep(max(0.0, self._begun_s + time_s - now_s))


class Orders:
    """The paths that come over the bus, and asking for them."""

    def __init__(self, bus: Bus) -> None:
        """None yet."""
        self._bus = bus
        self._paths: list[tuple[int, tuple[Pose, ...]]] = []
        self._asked_s = self._began_s = -math.inf
        self._waits = False

    def await_listener(
        self, topics: Mapping[str, str], image: str, should_stop: Callable[[], bool]
    ) -> None:
        """Open the vehicle's topics, and wait until somebody listens to its pings.

        Raises:
            ConfigError: Nobody does for a minute.
        """
        opened = {**topics, **VEHICLE_TOPICS}
        if not await_listener(self._bus, opened, image, LISTEN_S, should_stop):
            if should_stop():
                return
            raise ConfigError(
                f"nobody listens to {image} in DDS domain {self._bus.domain}; start `insonify "
                "live --plan` there first (ROS_DOMAIN_ID and CYCLONEDDS_URI say where)"
            )
        self.hear(0.2)

    def hear(self, wait_s: float = 0.0) -> None:
        """Take the paths that have come."""
        for message in self._bus.poll(lambda topic, kind: topic == PATH, wait_s):
            path = message.decode()
            rows = [pose_row(one.pose) for one in path.poses]
            if all(math.isfinite(number) for row in rows for number in row):
                way = [pose_from_quaternion(np.array(row[:3]), np.array(row[3:])) for row in rows]
                self._paths.append((stamp_ns(path.header), tuple(way)))

    def next_path(self, since_ns: int, *, unasked: bool) -> tuple[Pose, ...] | StopReason | None:
        """The next path, if one has come that was decided on a ping of then or later.

        Args:
            since_ns: The stamp of the ping.
            unasked: Whether it may come by itself, so that the first question can wait.

        Returns:
            Its poses; why there is none; or None while it is waited for.
        """
        now_s = time.monotonic()
        if not self._waits:
            self._waits, self._began_s = True, now_s
            self._asked_s = now_s if unasked else -math.inf
        known = [way for stamp, way in self._paths if stamp >= since_ns]
        if known:
            self._paths.clear()
            self._waits = False
            return known[-1] or StopReason.NOT_WORTH_IT
        if now_s - self._began_s > ANSWER_S:
            return StopReason.UNANSWERED
        if now_s - self._asked_s > ASK_S:
            self._asked_s = now_s
            self._bus.publish(REQUEST, messages.new("std_msgs/String", data="path"))
        return None


def publish_clock(bus: Bus, time_ns: int) -> None:
    """Say what time it is on the vehicle."""
    stamp = messages.header(time_ns, "").stamp
    bus.publish(CLOCK, messages.new("rosgraph_msgs/Clock", clock=stamp))


class ScanRobot:
    """A scan's watcher that publishes, and its planner, which takes what comes (a `Planner`)."""

    name = "bus"

    def __init__(
        self, bus: Bus, area: SurveyArea, should_stop: Callable[[], bool] = lambda: False
    ) -> None:
        """On the bus, not yet pinging.

        Args:
            bus: The bus.
            area: The order: where the first scan goes.
            should_stop: Asked while it waits.
        """
        self.pace, self.orders = RealTime(), Orders(bus)
        self._bus, self._area, self._should_stop = bus, area, should_stop
        self._recorder = ScanRecorder(self)

    def await_listener(self) -> None:
        """Wait until somebody listens to the pings.

        Raises:
            ConfigError: Nobody does for a minute.
        """
        self.orders.await_listener(PING_TOPICS, f"/{SONAR}/image", self._should_stop)

    def watch(self, run: Run, step: Step) -> None:
        """Publish a step of the scan; at the pace of its pings, if no vehicle has a clock."""
        if isinstance(step, Pinged) and run.flight is None:
            self.pace((self._recorder.stamp_ns + _STEP_NS) * 1e-9)
        self._recorder.watch(run, step)
        if isinstance(step, Pinged):
            self.orders.hear()

    def write(self, topic: str, message: Any, time_ns: int) -> None:
        """Publish a message of the recorder's."""
        if topic in _OWN:
            return
        self._bus.publish(topic, message, latched="static" in topic)
        if topic == ESTIMATE:
            publish_clock(self._bus, time_ns)

    def next_scan(self, belief: Belief, nav: Nav) -> Decision:
        """The first scan of the order; then what comes over the bus."""
        if not nav.scans:
            return Decision(path=path_over_centre(self._area, self._area.heading_rad))
        while not self._should_stop():
            self.orders.hear(0.1)
            stamp = self._recorder.stamp_ns
            answer = self.orders.next_path(stamp, unasked=len(nav.scans) > 1)
            if isinstance(answer, StopReason):
                return Decision(stop=answer)
            if answer is not None:
                return Decision(path=ScanPath(answer))
        return Decision(stop=StopReason.INTERRUPTED)


class TourRobot:
    """A tour that is published while it is flown: its pings, and at every tick its vehicle."""

    def __init__(
        self, bus: Bus, settings: VehicleSettings, frequency_hz: Mapping[str, float]
    ) -> None:
        """On the bus, with no vehicle yet.

        Args:
            bus: The bus.
            settings: The vehicle's.
            frequency_hz: Of each sonar, by its name.
        """
        self.orders = Orders(bus)
        self.craft: Craft | None = None
        self._wait = RealTime()
        self._bus, self._settings, self._frequency_hz = bus, settings, frequency_hz
        self._last_ns = self._held_ns = 0
        self._flown = 0

    @property
    def topics(self) -> dict[str, str]:
        """What its sonars publish."""
        return {t: kind for name in self._frequency_hz for t, kind in ping_topics(name).items()}

    def pace(self, time_s: float) -> None:
        """Wait for a tick's time, and publish the vehicle of then."""
        self._wait(time_s)
        self.orders.hear()
        craft = self.craft
        if craft is None:
            return
        now = round(time_s * 1e9)
        pose = craft.estimated_pose
        link = ("odom", "base_link", transform_from_pose(pose))
        moving = craft.true_state[7:13]
        self._bus.publish("/tf", messages.transforms([link], now))
        self._bus.publish(ESTIMATE, believed_odometry(craft, pose, now))
        self._bus.publish(TRUTH, messages.odometry(craft.true_pose, now, "map", moving))
        for topic, message, _ in reading_messages(craft.track.readings, self._settings.sensors):
            self._bus.publish(topic, message)
        publish_clock(self._bus, now)

    def publish(self, one: TourPing) -> None:
        """Publish a ping."""
        now = max(round(one.posed.ping.time_s * 1e9), self._last_ns + 1)  # a state's own stamp
        self._last_ns = now
        frequency_hz = self._frequency_hz[one.sonar]
        told = posed_messages(one.sonar, one.posed, now, frequency_hz, SOUND_SPEED_MPS)
        for topic, message in told.items():
            if topic not in (ESTIMATE, TRUTH):
                self._bus.publish(topic, message)

    def order(self, craft: Craft) -> tuple[Pose, ...] | StopReason | None:
        """What follows when a route is flown."""
        self._held_ns = self._held_ns or self._last_ns
        answer = self.orders.next_path(self._held_ns, unasked=self._flown > 0)
        if isinstance(answer, tuple):
            self._flown += 1
            self._held_ns = 0
        return answer
