"""A run, or a map alone, as a recording of the Rerun viewer (``.rrd``): what is seen, over time."""

from __future__ import annotations

import io
import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from insonify import __version__
from insonify.errors import ResultError
from insonify.extras import optional
from insonify.frames import directions_from_angles, transform_from_pose
from insonify.io.folders import RESULT
from insonify.io.maps import load_map
from insonify.io.maps.colours import probability_colours
from insonify.io.maps.surface import exposed_squares
from insonify.io.recordings.recording import Reading
from insonify.mapping.mapper import Mapper
from insonify.mapping.voxels import VoxelMap, probability_from_log_odds
from insonify.mission.explanation import Played, differing
from insonify.mission.result import ScanResult
from insonify.results.map import empty_mapper
from insonify.results.sources import folder_of, pings_of, result_of
from insonify.types import FanGeometry, Float64, Ping, Pose, PosedPing

PING, TIME = "ping", "time"
"""Time lines: the number of pings mapped, and the recording's clock."""
MAP, VEHICLE, SONAR, IMAGE = "world/map", "world/vehicle", "world/vehicle/sonar", "sonar"
FLOWN, TRULY = "world/flown", "world/truth/flown"
_MOST_MAPS = 12
"""Maps on the time line, beside those at the end of each scan."""
_MOST_TRACKS = 400
_EPOCH_S = 1e8
"""Times beyond it are of a clock that counts from 1970."""
_WIDTH = 480

_log = logging.getLogger(__name__)


def save_rerun(
    source: Path, path: Path, watch: Callable[[int, int], None] = lambda done, count: None
) -> VoxelMap:
    """Write a map's folder as a Rerun recording; a map file by itself without pings.

    The pings are mapped again, by the mapper and settings of the result, so that the map is seen to
    grow; the last map is the one that was saved.  Places are relative to the map's origin.

    Args:
        source: Result folder of ``scan`` or ``map``, or a map file.
        path: The file.
        watch: Told how many pings are written, of how many.

    Returns:
        The map.

    Raises:
        MapFileError: There is no such map, or it is damaged.
        MissingExtraError: The package rerun-sdk, or the packages for reports, are not installed.
        InsonifyError: Its pings are at hand, and cannot be read.
    """
    rerun = optional("rerun", "rerun", "a Rerun recording")
    saved = load_map(source)
    played, mapper, title = _sources(source, saved)
    with rerun.RecordingStream("insonify", recording_id=title, send_properties=False) as stream:
        rerun.set_log_time_enabled(False, recording=stream)
        rerun.set_log_tick_enabled(False, recording=stream)
        stream.save(path, default_blueprint=_blueprint(rerun))
        log = _Log(rerun, stream, saved, mapper, sum(sum(one.scans) for one in played))
        stream.send_recording_name(title)
        stream.log("world", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        stream.log("about", rerun.TextDocument(_about(title, saved)), static=True)
        for number, scan, posed, last in _pings(played):
            log.ping(number, scan, posed)
            if last:
                log.end_scan(scan)
            watch(number, log.total)
        log.end()
    return saved


def _sources(source: Path, saved: VoxelMap) -> tuple[Sequence[Played], Mapper | None, str]:
    """The pings of a map, and an empty mapper for them; none of a map by itself."""
    folder = folder_of(source)
    if not (folder / RESULT).is_file():
        return (), None, source.name
    result = result_of(source)
    title = folder.resolve().name
    if isinstance(result, ScanResult):
        title = f"{result.scenario}, {result.planner} planner, seed {result.seed}"
    try:
        return pings_of(folder, result, Reading()), _mapper(folder, saved), title
    except ResultError as err:
        _log.warning("%s; only the map is written", err)
        return (), None, title


def _mapper(folder: Path, saved: VoxelMap) -> Mapper:
    mapper = empty_mapper(folder, saved.voxel_m)
    mapper.voxels.origin_m = saved.origin_m
    return mapper


def _pings(played: Sequence[Played]) -> Iterator[tuple[int, int, PosedPing, bool]]:
    """The pings of a map with their number and that of their scan, and whether they end it."""
    number = scan = 0
    for one in played:
        pings = iter(one.recording)
        for count in one.scans:
            scan += 1
            for left, posed in zip(range(count - 1, -1, -1), pings, strict=False):
                number += 1
                yield number, scan, posed, left == 0


def _about(title: str, saved: VoxelMap) -> str:
    told = f"{title}\n\nWritten by insonify {__version__}. Voxels of {saved.voxel_m:g} m."
    if any(saved.origin_m):
        told += " Places are relative to ({:.10g}, {:.10g}, {:.10g}) m.".format(*saved.origin_m)
    return told


def _blueprint(rerun: Any) -> Any:
    """How the viewer is arranged at first: the world beside the sonar's image."""
    views = optional("rerun.blueprint", "rerun", "a Rerun recording")
    world = views.Spatial3DView(origin="world", name="World")
    image = views.Spatial2DView(origin=IMAGE, name="Sonar, port on the left")
    words = views.TextLogView(origin="log", name="Log")
    side = views.Vertical(image, words, row_shares=[3, 1])
    return views.Blueprint(views.Horizontal(world, side, column_shares=[2, 1]))


@dataclass(slots=True, eq=False)
class _Log:
    """Writes pings, the way flown and the map as it grows."""

    rerun: Any
    stream: Any
    saved: VoxelMap
    mapper: Mapper | None
    total: int
    fan: FanGeometry | None = None
    mapped: int = 0
    flown: dict[str, list[tuple[float, float, float]]] = field(
        default_factory=lambda: {FLOWN: [], TRULY: []}
    )

    def ping(self, number: int, scan: int, posed: PosedPing) -> None:
        """Write a ping, and map it."""
        self._set_time(number, posed.ping.time_s)
        picture = self.rerun.EncodedImage(contents=_png(posed.ping), media_type="image/png")
        self.stream.log(IMAGE, picture)
        if posed.pose is not None:
            self._place(posed, posed.pose)
            if number % (1 + self.total // _MOST_TRACKS) == 0 or number == self.total:
                self._draw_tracks()
            if self.mapper is not None:
                self.mapper.integrate(posed.ping, posed.pose)
                self.mapped += 1
                if number % (1 + self.total // _MOST_MAPS) == 0:
                    self._draw_map(self.mapper.voxels)

    def end_scan(self, scan: int) -> None:
        """Write the map after a scan."""
        self.stream.log("log", self.rerun.TextLog(f"scan {scan} is flown"))
        if self.mapper is not None and self.mapped:
            self.mapper.finish_scan()
            self._draw_map(self.mapper.voxels)

    def end(self) -> None:
        """Write the map as it was saved, and say if it was made otherwise."""
        self._draw_map(self.saved)
        if self.mapper is None:
            return
        if self.mapped < self.total:
            _log.warning(
                "%d of %d pings have no pose here, so the map is not seen to grow by them",
                self.total - self.mapped, self.total,
            )  # fmt: skip
        elif differing(self.mapper.voxels, self.saved):
            _log.warning(
                "mapped again, the map differs from the one that was saved, which is the last one"
            )

    def _set_time(self, number: int, time_s: float) -> None:
        self.stream.set_time(PING, sequence=number)
        if abs(time_s) > _EPOCH_S:
            self.stream.set_time(TIME, timestamp=time_s)
        else:
            self.stream.set_time(TIME, duration=time_s)

    def _place(self, posed: PosedPing, pose: Pose) -> None:
        """Where the vehicle and its sonar are, and the way they have come."""
        origin_m = self.saved.origin_m
        self.stream.log(VEHICLE, self._transform(pose.relative_to(origin_m)))
        if posed.ping.geometry != self.fan:
            self.fan = posed.ping.geometry
            self.stream.log(SONAR, self._transform(self.fan.mount))
            outline = self.rerun.LineStrips3D(_outline(self.fan), colors=[255, 190, 60])
            self.stream.log(f"{SONAR}/fan", outline)
        self.flown[FLOWN].append(pose.relative_to(origin_m).position_m)
        if posed.true_pose is not None and posed.true_pose != pose:
            self.flown[TRULY].append(posed.true_pose.relative_to(origin_m).position_m)

    def _transform(self, pose: Pose) -> Any:
        matrix = transform_from_pose(pose)
        return self.rerun.Transform3D(translation=matrix[:3, 3], mat3x3=matrix[:3, :3])

    def _draw_tracks(self) -> None:
        for (name, places), colour in zip(self.flown.items(), _TRACK_COLOURS, strict=True):
            if places:
                line = self.rerun.LineStrips3D([places], colors=[colour])
                self.stream.log(name, line)

    def _draw_map(self, voxels: VoxelMap) -> None:
        """Write the occupied voxels that can be seen; those with others on all sides cannot."""
        occupied = voxels.select()
        index = occupied.index
        bare = np.zeros(0, np.int64)
        if len(index):
            bare = np.unique(exposed_squares(index - index.min(axis=0) + 1)[1])
        centres = (index[bare] + 0.5) * voxels.voxel_m
        odds = occupied.log_odds[bare]
        boxes = self.rerun.Boxes3D(
            centers=centres.astype(np.float32),
            half_sizes=np.full((len(bare), 3), voxels.voxel_m / 2, np.float32),
            colors=probability_colours(probability_from_log_odds(odds)),
            fill_mode="solid",
        )
        self.stream.log(MAP, boxes)


_TRACK_COLOURS = ([70, 150, 255], [240, 110, 60])
"""Of the way as it was believed to be, and as it was."""


def _png(ping: Ping) -> bytes:
    """A ping in fan view, ahead up, port left."""
    from insonify.report.fans import fan_pixels

    picture, _ = fan_pixels(ping, _WIDTH, 2 * _WIDTH)
    grey = np.nan_to_num(np.clip(picture[::-1], 0.0, 1.0) ** 0.6)
    stream = io.BytesIO()
    Image.fromarray(np.round(255.0 * grey).astype(np.uint8)).save(stream, format="png")
    return stream.getvalue()


def _outline(fan: FanGeometry) -> list[Float64]:
    """The edges of a fan in the sonar's frame: its upper and lower borders, and the corners."""
    azimuths = np.linspace(-fan.azimuth_fov_rad / 2, fan.azimuth_fov_rad / 2, 25)
    borders = []
    for elevation in (fan.elevation_fov_rad / 2, -fan.elevation_fov_rad / 2):
        arc = directions_from_angles(azimuths, np.full_like(azimuths, elevation))
        near, far = fan.range_min_m * arc, fan.range_max_m * arc
        borders.append(np.concatenate([near, far[::-1], near[:1]]))
    upper, lower = borders
    return [upper, lower, *(np.stack([upper[k], lower[k]]) for k in (25, 49))]
