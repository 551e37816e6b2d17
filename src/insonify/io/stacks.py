"""Many pings of one sonar in one archive, written as they come."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from insonify.io.pings import fan_arrays
from insonify.types import Array, FanGeometry, PosedPing


class PingStack:
    """An archive of pings of one fan; images wait in a file of raw numbers until all are there.

    Arrays: ``images`` (pings, bins, beams) float32 in [0, 1], the first beam to port; ``time_s``
    and ``head_rad`` (pings,); ``true_pose`` and ``estimated_pose`` (pings, 6) of the vehicle and
    ``mount`` (pings, 6) of the sonar on it, x, y, z (m), roll, pitch, yaw (rad);
    ``estimated_std`` (pings, 2); ``azimuth_fov_rad``, ``elevation_fov_rad``, ``range_min_m`` and
    ``range_max_m``.
    """

    def __init__(self, path: Path) -> None:
        """Begin beside a file that does not exist yet."""
        self._path, self._raw = path, path.with_name(f".{path.stem}.raw")
        self._images = self._raw.open("wb")
        self._numbers: dict[str, list[Any]] = {
            name: []
            for name in (
                "time_s",
                "head_rad",
                "true_pose",
                "estimated_pose",
                "estimated_std",
                "mount",
            )
        }
        self.geometry: FanGeometry | None = None

    def write(self, posed: PosedPing) -> None:
        """Take the next ping; if nobody says where it truly was, it was where it is said to be."""
        ping, numbers = posed.ping, self._numbers
        self.geometry = self.geometry or ping.geometry
        assert posed.pose is not None
        self._images.write(np.ascontiguousarray(ping.image, np.float32).tobytes())
        numbers["time_s"].append(ping.time_s)
        numbers["head_rad"].append(ping.head_rad)
        numbers["true_pose"].append((posed.true_pose or posed.pose).numbers)
        numbers["estimated_pose"].append(posed.pose.numbers)
        numbers["estimated_std"].append(posed.pose.std)
        numbers["mount"].append(ping.geometry.mount.numbers)

    @property
    def times_s(self) -> list[float]:
        """When the pings were sent."""
        return self._numbers["time_s"]

    def finish(self) -> Array | None:
        """Write the archive; its images, which are read from the raw file; None of no pings."""
        self._images.close()
        if self.geometry is None:
            return None
        shape = (len(self.times_s), self.geometry.bins, self.geometry.beams)
        images = np.memmap(self._raw, np.float32, "r", shape=shape)
        with self._path.open("wb") as file:
            np.savez_compressed(
                file,
                allow_pickle=False,
                images=images,
                **{name: np.array(values) for name, values in self._numbers.items()},
                **fan_arrays(self.geometry),
            )
        return images

    def close(self) -> None:
        """Leave no raw numbers behind."""
        self._images.close()
        self._raw.unlink(missing_ok=True)
