"""The decisions of a scan and the paths flown, as one NumPy archive."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from insonify.errors import GeometryError, RecordingError
from insonify.io.archives import read_archive
from insonify.planning.clusters import Cluster
from insonify.planning.decision import Decision, DecisionRecord, Look
from insonify.types import Array, Pose, ScanPath, StopReason

FORMAT, VERSION = "insonify-decisions", 1


def save_decisions(
    path: Path, decisions: Sequence[DecisionRecord], flown: Sequence[ScanPath]
) -> None:
    """Write what a planner answered, and why, and where the sonar then pinged.

    Arrays: ``format``, ``version``; ``pings`` (decisions,) mapped before each; ``flown`` (pings, 6)
    poses x, y, z (m), roll, pitch, yaw (rad), and ``flown_scan`` (pings,) from 1.  Of decision K,
    where it has them: ``K_path`` (waypoints, 6); ``K_stop``, a reason's name; ``K_entropy_bits``
    (nx, ny); ``K_candidates`` (candidates, 6), ``K_h_sum``, ``K_h_cluster``, ``K_best``,
    ``K_termination``; ``K_cluster_m`` (voxels, 3) and ``K_cluster_bits`` (voxels,).
    """
    arrays: dict[str, Array] = {
        "pings": np.array([record.pings for record in decisions], np.int64),
        "flown": _rows(pose for path in flown for pose in path.waypoints),
        "flown_scan": np.repeat(
            np.arange(1, len(flown) + 1), [len(path.waypoints) for path in flown]
        ),
    }
    for number, record in enumerate(decisions):
        found = _arrays(record)
        arrays |= {f"{number}_{name}": values for name, values in found.items()}
    with path.open("wb") as file:
        np.savez_compressed(
            file, format=np.array(FORMAT), version=np.array(VERSION), allow_pickle=False, **arrays
        )


def load_decisions(path: Path) -> tuple[tuple[DecisionRecord, ...], tuple[ScanPath, ...]]:
    """Read what `save_decisions` wrote: the decisions and the paths flown.

    Raises:
        RecordingError: The file is missing, is no such file, or is damaged.
    """
    arrays = read_archive(path, FORMAT, VERSION, RecordingError)
    try:
        poses, scans = _poses(arrays["flown"]), arrays["flown_scan"].tolist()
        if max(scans, default=0) > len(scans):
            raise ValueError("it counts more scans than poses")
        if scans and set(scans) != set(range(1, max(scans) + 1)):
            raise ValueError("scans are missing")
        flown = [
            ScanPath(tuple(pose for pose, scan in zip(poses, scans, strict=True) if scan == number))
            for number in range(1, max(scans, default=0) + 1)
        ]
        records = tuple(
            _record(int(pings), {
                name.removeprefix(f"{number}_"): arrays[name]
                for name in arrays if name.startswith(f"{number}_")
            })
            for number, pings in enumerate(arrays["pings"])
        )  # fmt: skip
    except (KeyError, ValueError, TypeError, IndexError, AttributeError, GeometryError) as err:
        raise RecordingError(f"{path}: damaged, it lacks or garbles an array ({err})") from err
    return records, tuple(flown)


def _arrays(record: DecisionRecord) -> dict[str, Array]:
    decision, found = record.decision, {}
    if decision.path is not None:
        found["path"] = _rows(decision.path.waypoints)
    if decision.stop is not None:
        found["stop"] = np.array(decision.stop.value)
    if record.entropy_bits is not None:
        found["entropy_bits"] = record.entropy_bits
    look = decision.look
    if look is not None:
        found |= {
            "candidates": _rows(look.candidates),
            "h_sum": look.h_sum,
            "h_cluster": look.h_cluster,
            "best": np.array(look.best),
            "termination": np.array(look.termination),
            "cluster_m": look.cluster.voxels_m,
            "cluster_bits": look.cluster.voxel_entropy,
        }
    return found


def _record(pings: int, arrays: dict[str, Array]) -> DecisionRecord:
    look = None
    if "candidates" in arrays:
        cluster = Cluster.of(arrays["cluster_m"], arrays["cluster_bits"])
        look = Look(
            cluster,
            _poses(arrays["candidates"]),
            arrays["h_sum"],
            arrays["h_cluster"],
            int(arrays["best"]),
            float(arrays["termination"]),
        )
    path = ScanPath(_poses(arrays["path"])) if "path" in arrays else None
    stop = StopReason(str(arrays["stop"])) if "stop" in arrays else None
    bits = arrays.get("entropy_bits")
    if bits is not None and (bits.ndim != 2 or bits.dtype != np.float32):
        raise ValueError("the entropy is no picture")
    return DecisionRecord(pings, Decision(path, stop, look), bits)


def _rows(poses: Iterable[Pose]) -> Array:
    return np.array([pose.numbers for pose in poses], np.float64).reshape(-1, 6)


def _poses(rows: Array) -> tuple[Pose, ...]:
    return tuple(Pose(*(float(value) for value in row)) for row in rows)
