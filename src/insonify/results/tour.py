"""What ``fly`` leaves: images by sonar, one table of when and where, turns, track and pictures."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from insonify.config.toml import config_to_toml
from insonify.imaging.tour import MountedSonar, Tour, TourPing, turns_of
from insonify.io.pings import save_sweep
from insonify.io.stacks import PingStack
from insonify.io.trajectories import POSE_COLUMNS, pose_row, save_track
from insonify.mission.result import TourResult
from insonify.report.fans import draw_fan, scale_of
from insonify.results.files import CONFIG, save_result
from insonify.sonar.devices import Kind
from insonify.sonar.scanning import deskewed_image, head_angles, polar_image
from insonify.types import Array, FanGeometry, Ping, StopReason
from insonify.vehicle.craft import Craft, pose_errors

COLUMNS = (
    "time_s",
    "sonar",
    "number",
    "head_deg",
    *(f"true_{name}" for name in POSE_COLUMNS),
    *(f"estimated_{name}" for name in POSE_COLUMNS),
)


class TourWriter:
    """Writes a tour into a folder as it is flown; one turn of each sonar is in memory at most.

    ``pings.csv`` has the `COLUMNS` of every ping, ``trajectory.csv`` the vehicle's track.
    ``SONAR.npz`` is a `PingStack` of a sonar's pings in their order.  Each whole turn of a scanning
    head is an archive of its own, ``SONAR-NUMBER.npz``.
    """

    def __init__(self, config: Tour, folder: Path) -> None:
        """Begin in a folder that exists.

        Args:
            config: What is flown.
            folder: Where the files go.
        """
        self._config, self._folder = config, folder
        self._table = (folder / "pings.csv").open("w", encoding="utf-8", newline="")
        self._rows = csv.writer(self._table, lineterminator="\n")
        self._rows.writerow(COLUMNS)
        self._sonars = {one.name: _SonarWriter(one, config.model, folder) for one in config.sonars}

    def write(self, one: TourPing) -> None:
        """Take the next ping of any sonar."""
        true, estimated = one.posed.true_pose, one.posed.pose
        assert true is not None
        assert estimated is not None
        ping = one.posed.ping
        numbers = [*pose_row(true), *pose_row(estimated)]
        head = f"{math.degrees(ping.head_rad):.9g}"
        self._rows.writerow(
            [f"{ping.time_s:.9g}", one.sonar, one.number, head]
            + [f"{value:.9g}" for value in numbers]
        )
        self._sonars[one.sonar].write(one)

    def finish(self, craft: Craft, reason: StopReason) -> TourResult:
        """Write what is known at the end.

        Args:
            craft: The vehicle.
            reason: Why the tour ended.
        """
        (self._folder / CONFIG).write_text(config_to_toml(self._config, "fly"), encoding="utf-8")
        save_track(craft.track, self._folder / "trajectory.csv")
        result = TourResult(
            world=self._config.world,
            vehicle=self._config.vehicle.name,
            seed=self._config.seed,
            stop_reason=reason,
            time_s=craft.time_s,
            path_m=round(craft.track.length_m, 6),
            pose_error=pose_errors(craft.track),
            pings={name: sonar.finish() for name, sonar in self._sonars.items()},
        )
        save_result(result, self._folder)
        return result

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._table.close()
        for sonar in self._sonars.values():
            sonar.close()


class _SonarWriter:
    """The files of one sonar."""

    def __init__(self, mounted: MountedSonar, model: str, folder: Path) -> None:
        self._mounted, self._folder = mounted, folder
        self._scanning = mounted.sonar.kind is Kind.SCANNING
        self._scale = scale_of(model, mounted.sonar.display_gamma)
        self._stack = PingStack(folder / f"{mounted.name}.npz")
        self._turn: list[TourPing] = []
        self._turns = 0

    def write(self, one: TourPing) -> None:
        """Take the next ping."""
        self._stack.write(one.posed)
        if self._scanning:
            self._turn.append(one)
            if len(self._turn) == len(head_angles(self._mounted.sonar)):
                self._write_turn(self._turn)
                self._turn = []

    def finish(self) -> int:
        """Write the archive; how many pings there were."""
        images, fan = self._stack.finish(), self._stack.geometry
        if images is None or fan is None:
            return 0
        if not self._scanning:
            self._draw_some(images, fan)
        return len(images)

    def close(self) -> None:
        """Leave no raw numbers behind."""
        self._stack.close()

    def _draw_some(self, images: Array, fan: FanGeometry) -> None:
        """Three pings in fan view."""
        count = len(images)
        for share in (1, 2, 3) if count > 3 else ():
            number = count * share // 4
            time_s = self._stack.times_s[number]
            title = f"{self._mounted.name}, ping {number}, {time_s:.2f} s"
            picture = draw_fan(
                Ping(np.asarray(images[number]), fan, time_s), title, 8.0, self._scale
            )
            (self._folder / f"{self._mounted.name}-{number:05d}.png").write_bytes(picture)

    def _write_turn(self, pings: Iterable[TourPing]) -> None:
        """A whole turn as it came and de-skewed; its poses are those of the head's base."""
        device, name = self._mounted.sonar, f"{self._mounted.name}-{self._turns:05d}"
        (turn,) = turns_of(pings, self._mounted)
        first = turn[0].pose
        assert first is not None
        polar, deskewed = polar_image(turn, device), deskewed_image(turn, device, first)
        save_sweep(self._folder / f"{name}.npz", turn, polar, deskewed, ())
        for kind, image in (("polar", polar), ("deskewed", deskewed)):
            title = f"{self._mounted.name}, turn {self._turns}, {kind}, from {image.time_s:.2f} s"
            picture = draw_fan(image, title, 8.0, self._scale, smooth=True)
            (self._folder / f"{name}-{kind}.png").write_bytes(picture)
        self._turns += 1
