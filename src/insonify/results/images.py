"""What ``simulate`` leaves: arrays in ``pings``, pictures in ``pictures``, and a summary."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from insonify.config.settings import Table
from insonify.config.toml import config_to_toml
from insonify.imaging.route import Line, Profile, Record, Shot, Simulation, Turn, ping_times
from insonify.io.pings import save_ping, save_sidescan, save_sweep
from insonify.io.stacks import PingStack
from insonify.mission.result import ImagesResult
from insonify.report.fans import (
    draw_fan,
    draw_polar,
    draw_soundings,
    draw_truth,
    draw_waterfall,
    draw_waterfall_truth,
    picture_png,
    scale_of,
)
from insonify.results.files import CONFIG, save_result
from insonify.sonar.devices import Kind
from insonify.sonar.scanning import sidescan_line, waterfall
from insonify.sonar.truth import Truth
from insonify.types import Array, Float64, PosedPing

_FANS = (Kind.FORWARD_LOOKING, Kind.PROFILING)
MANY, PICTURED = 100, 10
"""Of more pings than this, all are in one archive, and so many are drawn."""


class ImagesWriter:
    """Writes records into a folder as they come.

    Each ping, or turn, is a file of `io.pings`, with its pictures.  Many fans without truth are one
    archive instead, ``pings.npz`` (`io.stacks`), and a few of them are drawn.
    """

    def __init__(
        self, config: Simulation, labels: Sequence[str], folder: Path, *, truth: bool = False
    ) -> None:
        """Begin in a folder that exists.

        Args:
            config: What is simulated.
            labels: Of the world's bodies.
            folder: Where the files go.
            truth: Whether pings come with their truth.
        """
        self._config, self._labels, self._folder = config, tuple(labels), folder
        self._arrays, self._pictures = folder / "pings", folder / "pictures"
        count = len(ping_times(config)) if config.sonar.kind in _FANS and not truth else 0
        self._stack = PingStack(folder / "pings.npz") if count > MANY else None
        self._every = 1 if self._stack is None else math.ceil(count / PICTURED)
        if self._stack is None:
            self._arrays.mkdir()
        self._pictures.mkdir()
        self._rows: list[Table] = []
        self._lines: list[Line] = []
        self._points: list[Float64] = []
        self._title = f"{config.sonar.name} in {config.world_name}"
        self._scale = scale_of(config.model, config.sonar.display_gamma)
        (folder / CONFIG).write_text(config_to_toml(config, "simulate"), encoding="utf-8")

    def write(self, record: Record) -> None:
        """Write a record."""
        if isinstance(record, Line):
            self._write_line(record)
        elif isinstance(record, Turn):
            self._write_turn(record)
        elif isinstance(record, Profile):
            self._points.append(record.points)
            self._write_shot(record.shot)
        else:
            self._write_shot(record)

    def finish(self) -> ImagesResult:
        """Write what is made of all records, and the figures."""
        if self._lines:
            self._write_sidescan()
        if self._stack is not None:
            self._stack.finish()
            self._stack.close()
        if self._points:
            points = np.concatenate(self._points)
            np.savetxt(self._folder / "soundings.xyz", points, fmt="%.4f", header="x_m y_m z_m")
            self._picture("soundings", draw_soundings(points, self._title))
        config = self._config
        result = ImagesResult(
            world=config.world,
            sonar=config.sonar.name,
            sonar_kind=config.sonar.kind.value,
            model=config.model,
            renderer=config.renderer.value,
            seed=config.seed,
            labels=self._labels,
            pings=tuple(self._rows),
        )
        save_result(result, self._folder)
        return result

    def _write_shot(self, shot: Shot) -> None:
        name, ping = f"{shot.number:04d}", shot.posed.ping
        if self._stack is None:
            save_ping(self._arrays / f"{name}.npz", shot.posed, shot.truth)
        else:
            self._stack.write(shot.posed)
        if shot.number % self._every == 0:
            self._picture(f"{name}-fan", draw_fan(ping, self._title, 12.0, self._scale))
            self._picture(f"{name}-polar", draw_polar(ping, self._title, self._scale))
        if shot.truth is not None:
            self._picture(f"{name}-truth", draw_truth(ping, shot.truth, self._title, 12.0))
        if shot.picture is not None:
            self._picture(f"{name}-camera", picture_png(shot.picture))
        self._note(shot.posed, [shot.truth] if shot.truth is not None else [])

    def _write_turn(self, turn: Turn) -> None:
        name, title = f"{turn.number:04d}", self._title
        path = self._arrays / f"{name}.npz"
        save_sweep(path, turn.pings, turn.polar, turn.deskewed, turn.truths)
        scale = self._scale
        self._picture(f"{name}-fan", draw_fan(turn.polar, title, 8.0, scale, smooth=True))
        self._picture(f"{name}-polar", draw_polar(turn.polar, title, scale))
        deskewed = draw_fan(turn.deskewed, f"{title}, de-skewed", 8.0, scale, smooth=True)
        self._picture(f"{name}-deskewed", deskewed)
        if turn.picture is not None:
            self._picture(f"{name}-camera", picture_png(turn.picture))
        for posed in turn.pings:
            self._note(posed, [], head_deg=math.degrees(posed.ping.head_rad))

    def _write_line(self, line: Line) -> None:
        self._lines.append(line)
        truths = line.truths or (None, None)
        sides = zip(("port", "starboard"), (line.port, line.starboard), truths, strict=True)
        for side, posed, truth in sides:
            save_ping(self._arrays / f"{line.number:04d}-{side}.npz", posed, truth)
        self._note(line.port, line.truths)

    def _write_sidescan(self) -> None:
        """All lines as one image, one archive and, with truth, one picture of it."""
        lines = self._lines
        bin_m = lines[0].port.ping.geometry.bin_m
        images = (sidescan_line(one.port.ping.image, one.starboard.ping.image) for one in lines)
        image = waterfall(list(images))
        truth: dict[str, Array] = {}
        if lines[0].truths:
            for name in ("label", "shadow"):
                pixels = [[getattr(one, name) for one in line.truths] for line in lines]
                truth[name] = waterfall([sidescan_line(*both) for both in pixels])
        posed = [line.port for line in lines]
        save_sidescan(self._folder / "sidescan.npz", image, bin_m, posed, self._labels, truth)
        places = np.array([one.pose.position_m for one in posed if one.pose is not None])
        steps_m = np.linalg.norm(np.diff(places, axis=0), axis=1)
        along_m = np.concatenate([[0.0], np.cumsum(steps_m)])
        picture = draw_waterfall(image, bin_m, along_m, self._title, self._scale)
        self._picture("sidescan", picture)
        if truth:
            told = draw_waterfall_truth(
                truth["label"], truth["shadow"], self._labels, bin_m, along_m, self._title
            )
            self._picture("sidescan-truth", told)

    def _picture(self, name: str, png: bytes) -> None:
        (self._pictures / f"{name}.png").write_bytes(png)

    def _note(self, posed: PosedPing, truths: Sequence[Truth], **more: float) -> None:
        pose = posed.pose
        assert pose is not None
        row: Table = {
            "time_s": round(posed.ping.time_s, 6),
            "position_m": list(pose.position_m),
            "rpy_deg": [math.degrees(a) for a in (pose.roll_rad, pose.pitch_rad, pose.yaw_rad)],
        } | more
        for truth in truths:
            for label, name in enumerate(truth.labels):
                count = int((truth.label == label).sum())
                row.setdefault("pixels", {}).setdefault(name, 0)
                row["pixels"][name] += count
            row["shadow_pixels"] = row.get("shadow_pixels", 0) + int(truth.shadow.sum())
        self._rows.append(row)
