"""What `live` costs: ``python -m benchmarks.live_cost [--pings 200] [--beams 512] [--bins 1000]``.

Pings of a simulated wall, as messages of the bus, go through a session on one core that maps,
records and publishes: CPU time a ping, as whole and by part, and how many that is a second.
Odometry comes at 20 Hz between them.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from functools import partial
from pathlib import Path

os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import numpy as np

from insonify.io.recordings.recording import Reading
from insonify.io.recordings.ros import messages
from insonify.io.recordings.ros.bags import BagMessage
from insonify.live.counts import Counts
from insonify.live.keeping import Keeper
from insonify.live.poser import Poser
from insonify.live.publishing import Publisher
from insonify.live.session import Session, Watcher
from insonify.mapping.factory import make_mapper
from insonify.mapping.mapper import MappingSettings
from insonify.mission.remap import Remap
from insonify.types import FanGeometry, Ping, Pose

RATE_HZ, ODOMETRY_HZ = 20.0, 20.0


def said(pings: int, fan: FanGeometry) -> list[BagMessage]:
    """What a robot says that passes along a wall, as bytes."""
    rng = np.random.default_rng(1)
    store = messages.message_types()
    mount = messages.transforms([("base_link", "sonar", messages.IMAGE_FROM_SONAR)], 1)
    told = [("/tf_static", mount, 1)]
    for k in range(pings + 2):
        now = 10**9 + round(k / ODOMETRY_HZ * 1e9)
        pose = Pose(0.05 * k, 0.0, -5.0, yaw_rad=1.2)
        told.append(("/odometry", messages.odometry(pose, now, "odom"), now))
    image = (0.1 * rng.random((fan.bins, fan.beams))).astype(np.float32)
    image[fan.bins // 2 : fan.bins // 2 + 12] += 0.8
    for k in range(pings):
        now = 10**9 + round((k + 0.4) / RATE_HZ * 1e9)
        shown = np.roll(image, k % 7, axis=1)
        ping = messages.sonar_image(Ping(shown, fan), now, "sonar", 1e6, 1500.0)
        told.append(("/sonar/image", ping, now))
    found = []
    for topic, message, now in sorted(told, key=lambda one: one[2]):
        kind = message.__msgtype__
        data = bytes(store.serialize_cdr(message, kind))
        decode = partial(store.deserialize_cdr, data, kind)
        found.append(BagMessage(topic, kind, now, decode))
    return found


def cost(told: list[BagMessage], watchers: list[Watcher], voxel_m: float) -> tuple[float, Session]:
    """CPU seconds of all of it, in a session."""
    settings = MappingSettings(voxel_m=voxel_m)
    remap = Remap(settings, make_mapper("bayes", settings))
    session = Session(Poser(Reading(), Counts()), remap, watchers)
    begun = time.process_time()
    for message in told:
        session.take(message)
    session.finish()
    return time.process_time() - begun, session


def main() -> None:
    """Print what it costs."""
    parser = argparse.ArgumentParser(description="CPU of live a ping.")
    parser.add_argument("--pings", type=int, default=200)
    parser.add_argument("--beams", type=int, default=512)
    parser.add_argument("--bins", type=int, default=1000)
    parser.add_argument("--range", type=float, default=20.0, help="m")
    parser.add_argument("--voxel", type=float, default=0.1, help="m")
    options = parser.parse_args()
    fan = FanGeometry(2.27, 0.21, options.beams, options.bins, 0.2, options.range)
    told = said(options.pings, fan)
    cost(told[:40], [], options.voxel)  # kernels are loaded
    plain, _ = cost(told, [], options.voxel)
    with tempfile.TemporaryDirectory() as folder:
        keeper = Keeper(Path(folder))
        kept, _ = cost(told, [keeper.watch], options.voxel)
    store = messages.message_types()

    def send(topic: str, message: object) -> None:
        store.serialize_cdr(message, message.__msgtype__)  # type: ignore[attr-defined]

    publisher = Publisher([send], every_s=0.0)  # at every ping
    published, session = cost(told, [publisher.watch], options.voxel)
    count = session.counts.mapped
    sent_s = (published - plain) / count
    all_s = kept / count + sent_s / RATE_HZ  # once a second
    voxels = session.remap.mapper.voxels
    per_m3 = 512 * 5 / voxels.block_m**3
    for name, told_of in {
        "pings": f"{count} of {options.bins} x {options.beams}, {options.range:g} m",
        "decode, pose, map": f"{1e3 * plain / count:.1f} ms CPU a ping",
        "record": f"{1e3 * (kept - plain) / count:.1f} ms",
        "publish map and health": f"{1e3 * sent_s:.1f} ms, once a second",
        "all": f"{1e3 * all_s:.1f} ms a ping: {1.0 / all_s:.0f} pings/s",
        "map": f"{per_m3 * 1e3 / 1e6:.1f} MB a 1000 m3 of blocks, {options.voxel:g} m",
    }.items():
        print(f"{name:24} {told_of}")


if __name__ == "__main__":
    main()
