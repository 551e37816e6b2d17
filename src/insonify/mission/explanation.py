"""What made a voxel what it is: its map's pings mapped again, and what each showed of it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from insonify import memory
from insonify.errors import ConfigError, GeometryError, MemoryLimitError, RecordingError
from insonify.frames import world_from_sonar
from insonify.io.recordings.recording import Recording
from insonify.mapping.factory import bytes_per_voxel
from insonify.mapping.mapper import Explains, Mapper, MappingSettings, Shown
from insonify.mapping.pixels import Pixels, pixels_of
from insonify.mapping.voxels import (
    SURFACE,
    VOXELS_PER_BLOCK,
    VoxelMap,
    probability_from_log_odds,
)
from insonify.planning.active import EntropySettings
from insonify.planning.entropy import binary_entropy
from insonify.types import FanGeometry, Float32, Ping, PosedPing

_BEAMS, _BINS = 12, 24
"""Pixels to either side of a voxel's that are kept for pictures."""


@dataclass(frozen=True, slots=True)
class Played:
    """A recording, and how many of its first pings made a map, scan by scan."""

    recording: Recording
    scans: tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Cutout:
    """A part of a sonar image around a voxel's pixels.

    Attributes:
        image: (bins, beams) in [0, 1].
        first_beam: Of the whole image's.
        first_bin: Likewise.
        geometry: Of the whole image.
    """

    image: Float32
    first_beam: int
    first_bin: int
    geometry: FanGeometry


@dataclass(frozen=True, slots=True, eq=False)
class Glimpse:
    """A ping that reached the voxel, or changed it.

    Attributes:
        recording: Where it is from.
        number: Which of its pings, from 1.
        time_s: When its sound was sent, in the recording's clock.
        pixels: Those that the voxel covers; None if it lies outside the fan.
        brightest: The largest of them that is known, of 1; None if none is.
        echo_m: Range of the nearest echo before them, in their beams; None if there is none.
        shown: What it showed of the voxel.
        before: The voxel's log-odds before it.
        cutout: The image around the pixels.
    """

    recording: Path
    number: int
    time_s: float
    pixels: Pixels | None
    brightest: float | None
    echo_m: float | None
    shown: Shown
    before: float
    cutout: Cutout | None

    @property
    def change(self) -> float:
        """By how much it changed the voxel's log-odds."""
        return self.shown.log_odds - self.before

    @property
    def says(self) -> str:
        """What it showed, and what that did, in words."""
        shown, counted = self.shown, ((self.shown.lit, "lit"), (self.shown.dark, "dark"))
        of = f" {{}} of {shown.parts}" if shown.parts > 1 else ""
        told = ", ".join(word + of.format(count) for count, word in counted if count)
        if not self.change:
            return f"{told}: as it was" if told else self._silence
        way = "raised" if self.change > 0.0 else "lowered"
        return f"{told}: {way}" if told else f"{self._silence}; {way} by other evidence"

    @property
    def _silence(self) -> str:
        """Why it showed nothing of the voxel."""
        if self.pixels is None:
            return "outside the fan"
        if self.echo_m is not None:
            return f"hidden by an echo at {self.echo_m:.2f} m"
        if self.brightest is None:
            return "its pixels are not known"
        return "no ray shows it" if self.pixels.whole else "at the edge of the fan"


@dataclass(frozen=True, slots=True, eq=False)
class Explanation:
    """A voxel, and the pings that made it.

    Attributes:
        voxel: Its index.
        centre_m: In the world.
        log_odds: In the map that is explained.
        seen: The bits of what was seen of it there.
        marked: Whether that map tells surface from solid.
        replayed: After the replay.
        differing: How many voxels of all the map are others after the replay.
        pings: How many were replayed.
        glimpses: Those that reached it, or changed it, in their order.
    """

    voxel: tuple[int, int, int]
    centre_m: tuple[float, float, float]
    log_odds: float
    seen: int
    marked: bool
    replayed: float
    differing: int
    pings: int
    glimpses: tuple[Glimpse, ...]

    @property
    def state(self) -> str:
        """What the map holds it for: occupied, free, undecided, or unknown, never in view."""
        if not self.seen:
            return "unknown"
        if self.log_odds > 0.0:
            return "occupied"
        odds = np.array(self.log_odds, np.float32)
        entropy = float(binary_entropy(probability_from_log_odds(odds)))
        return "undecided" if entropy >= EntropySettings().high_entropy else "free"

    @property
    def surface(self) -> bool | None:
        """Whether a surface passes through it; None of a map that does not tell."""
        return bool(self.seen & SURFACE) if self.marked else None

    def telling(self, most: int) -> tuple[Glimpse, ...]:
        """The glimpses that mattered most, in their order: by change, then by what they showed."""
        seen = [one for one in self.glimpses if one.cutout is not None]
        ranked = sorted(seen, key=lambda one: (-abs(one.change), -(one.shown.lit + one.shown.dark)))
        chosen = set(map(id, ranked[:most]))
        return tuple(one for one in seen if id(one) in chosen)


def voxel_at(voxels: VoxelMap, place_m: Sequence[float]) -> tuple[int, int, int]:
    """The index of the voxel at a place of the world.

    Raises:
        GeometryError: It is no place, or lies outside the map.
    """
    told = ", ".join(f"{c:g}" for c in place_m)
    if not all(map(math.isfinite, place_m)):
        raise GeometryError(f"--voxel takes three finite numbers in metres, not ({told})")
    if not voxels.block_count:
        raise GeometryError(f"the map is empty, so there is no voxel at ({told}) m")
    local = np.subtract(place_m, voxels.origin_m)
    low_m = voxels.coords.min(axis=0) * voxels.block_m
    high_m = (voxels.coords.max(axis=0) + 1) * voxels.block_m
    if (local < low_m).any() or (local >= high_m).any():
        low, high = (
            ", ".join(f"{c:.6g}" for c in corner + voxels.origin_m) for corner in (low_m, high_m)
        )
        raise GeometryError(
            f"({told}) m lies outside the map, which reaches from ({low}) to ({high}) m"
        )
    x, y, z = (int(c) for c in np.floor(local / voxels.voxel_m))
    return x, y, z


def explain_voxel(
    played: Sequence[Played],
    mapper: Mapper,
    settings: MappingSettings,
    saved: VoxelMap,
    voxel: tuple[int, int, int],
    watch: Callable[[int, int], None] = lambda done, count: None,
) -> Explanation:
    """Replay the pings of a map, and note what each does to one of its voxels.

    Args:
        played: The pings.
        mapper: As the one that made the map, with an empty map.
        settings: The mapper's.
        saved: The map.
        voxel: Index of the voxel.
        watch: Told how many pings are replayed, of how many.

    Raises:
        ConfigError: The mapper cannot tell.
        RecordingError: A recording has not the pings that the map was made of.
        MemoryLimitError: The map would not fit into the memory that is free.
    """
    explaining = _check(mapper, saved, settings)
    mapper.voxels.origin_m = saved.origin_m
    replay = _Replay(explaining, voxel, settings.pixel_threshold / 255.0)
    total = sum(sum(one.scans) for one in played)
    for one in played:
        pings = _pings(one)
        for count in one.scans:
            for number, posed in itertools.islice(pings, count):
                replay.take(one.recording.path, number, posed)
                watch(replay.pings, total)
            replay.end_scan()
    x, y, z = ((np.array(voxel) + 0.5) * saved.voxel_m + saved.origin_m).tolist()
    log_odds, seen = saved.at(voxel)
    return Explanation(
        voxel=voxel,
        centre_m=(x, y, z),
        log_odds=log_odds,
        seen=seen,
        marked=saved.marked,
        replayed=replay.log_odds,
        differing=differing(mapper.voxels, saved),
        pings=replay.pings,
        glimpses=tuple(replay.glimpses),
    )


class _Replay:
    """A mapper fed with pings, and what they did to a voxel so far."""

    def __init__(self, mapper: Explains, voxel: tuple[int, int, int], threshold: float) -> None:
        self._mapper, self._voxel, self._threshold = mapper, voxel, threshold
        self.log_odds, self.pings = 0.0, 0
        self.glimpses: list[Glimpse] = []

    def take(self, recording: Path, number: int, posed: PosedPing) -> None:
        """Map a ping, if it has a pose, and note what it did."""
        self.pings += 1
        if posed.pose is None:
            return
        voxels, ping = self._mapper.voxels, posed.ping
        pose = posed.pose.relative_to(voxels.origin_m)
        transform = world_from_sonar(pose, ping.geometry.mount)
        pixels = pixels_of(self._voxel, voxels.voxel_m, transform, ping.geometry)
        shown = self._mapper.explain(ping, pose, self._voxel)
        if pixels is not None or shown.log_odds != self.log_odds or shown.lit or shown.dark:
            self.glimpses.append(
                Glimpse(
                    recording=recording,
                    number=number,
                    time_s=ping.time_s,
                    pixels=pixels,
                    brightest=None if pixels is None else _brightest(ping.image, pixels),
                    echo_m=None if pixels is None else _echo_before(ping, pixels, self._threshold),
                    shown=shown,
                    before=self.log_odds,
                    cutout=None if pixels is None else _cut_out(ping, pixels),
                )
            )
        self.log_odds = shown.log_odds

    def end_scan(self) -> None:
        """What the mapper does at the end of a scan counts to no ping."""
        self._mapper.finish_scan()
        self.log_odds, _ = self._mapper.voxels.at(self._voxel)


def _pings(played: Played) -> Iterator[tuple[int, PosedPing]]:
    """The pings of a recording that made the map, with their numbers from 1."""
    wanted, number = sum(played.scans), 0
    for number, posed in enumerate(itertools.islice(played.recording, wanted), 1):
        yield number, posed
    if number < wanted:
        raise RecordingError(
            f"{played.recording.path}: holds {number} pings, and the map was made of {wanted} of "
            "it; it is cut off, or another recording"
        )


def _brightest(image: Float32, pixels: Pixels) -> float | None:
    (beam, last_beam), (cell, last_cell) = pixels.beams, pixels.bins
    part = image[cell : last_cell + 1, beam : last_beam + 1]
    known = part[~np.isnan(part)]
    return float(known.max()) if known.size else None


def _echo_before(ping: Ping, pixels: Pixels, threshold: float) -> float | None:
    """Range of the first pixel over the threshold before a voxel's, in its beams."""
    beams = slice(pixels.beams[0], pixels.beams[1] + 1)
    echoes = (ping.image[: pixels.bins[0], beams] > np.float32(threshold)).any(axis=1)
    return float(ping.geometry.bin_ranges_m[int(np.argmax(echoes))]) if echoes.any() else None


def _cut_out(ping: Ping, pixels: Pixels) -> Cutout:
    beam, cell = max(0, pixels.beams[0] - _BEAMS), max(0, pixels.bins[0] - _BINS)
    part = ping.image[cell : pixels.bins[1] + _BINS + 1, beam : pixels.beams[1] + _BEAMS + 1]
    return Cutout(part.copy(), beam, cell, ping.geometry)


def differing(ours: VoxelMap, saved: VoxelMap) -> int:
    """How many voxels have other log-odds in one of two maps than in the other."""
    slots = ours.find(saved.coords)
    there = slots >= 0
    differing = int((ours.log_odds[slots[there]] != saved.log_odds[there]).sum())
    lacking = saved.find(ours.coords) < 0
    return differing + sum(
        int(np.count_nonzero(odds)) for odds in (saved.log_odds[~there], ours.log_odds[lacking])
    )


def _check(mapper: Mapper, saved: VoxelMap, settings: MappingSettings) -> Explains:
    """Refuse what cannot be replayed, before it is."""
    if not isinstance(mapper, Explains):
        raise ConfigError(
            f"mapper {mapper.name!r} cannot say what made a voxel; give it a method "
            "explain(ping, pose, voxel), or derive it from BayesMapper (docs/own.md)"
        )
    voxels = saved.block_count * VOXELS_PER_BLOCK
    needed = float(voxels * bytes_per_voxel(mapper.name, settings))
    if not memory.fits(needed):
        raise MemoryLimitError(
            f"to make the map again needs {memory.shortage(needed)}; close other programs, or do "
            "it on a larger machine"
        )
    return mapper
