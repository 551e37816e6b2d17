"""A dataset as WebDataset shards: tar files in which what belongs to a view lies together.

Of each view ``000000.json``, ``000000.mask.png`` and ``000000.png``; its key is what comes before
the first dot.  Shards are named after their part: ``train-{000000..000003}.tar`` are all of it.
"""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from insonify.imaging.collection import Collection
from insonify.results.dataset.coco import categories_of, file_name, pose_m_deg

SHARDS = "shards"
VIEWS_A_SHARD = 1000


def write_shards(
    folder: Path,
    views: Collection,
    rows: Iterable[dict[str, Any]],
    images: Path,
    masks: Path,
) -> None:
    """Write the shards of all parts.

    Args:
        folder: In which they are put; it exists.
        views: The dataset.
        rows: What `coco.row` said of each view, in order.
        images: Folder of the pictures.
        masks: Folder of their masks.
    """
    written = dict.fromkeys(views.parts, 0)
    shards: dict[str, tarfile.TarFile] = {}
    try:
        for number, said in enumerate(rows):
            part, name = views.part(number), file_name(number)
            shard, rest = divmod(written[part], VIEWS_A_SHARD)
            if not rest:
                if part in shards:
                    shards[part].close()
                path = folder / f"{part}-{shard:06d}.tar"
                shards[part] = tarfile.open(path, "w", format=tarfile.USTAR_FORMAT)  # noqa: SIM115
            key = Path(name).stem
            told = json.dumps(_about(views, number, said)).encode()
            _add(shards[part], f"{key}.json", told)
            _add(shards[part], f"{key}.mask.png", (masks / name).read_bytes())
            _add(shards[part], f"{key}.png", (images / name).read_bytes())
            written[part] += 1
    finally:
        for open_shard in shards.values():
            open_shard.close()


def _about(views: Collection, number: int, said: dict[str, Any]) -> dict[str, Any]:
    fan, names = views.geometry, categories_of(views.labels)
    return {
        "number": number,
        "world": views.config.names[views.world(number)],
        "split": views.part(number),
        "pose_m_deg": pose_m_deg(said),
        "sonar": {
            "name": views.config.sonar.name,
            "azimuth_fov_rad": fan.azimuth_fov_rad,
            "elevation_fov_rad": fan.elevation_fov_rad,
            "range_min_m": fan.range_min_m,
            "range_max_m": fan.range_max_m,
        },
        "categories": names,
        "objects": [
            {"category": names[mask["category_id"] - 1]}
            | {key: mask[key] for key in ("category_id", "bbox", "area")}
            for mask in (one["mask"] for one in said["found"])
        ],
    }


def _add(shard: tarfile.TarFile, name: str, data: bytes) -> None:
    member = tarfile.TarInfo(name)  # of no time and nobody, so that the bytes are the same
    member.size = len(data)
    shard.addfile(member, io.BytesIO(data))
