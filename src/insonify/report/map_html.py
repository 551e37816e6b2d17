"""The report of a map made from recordings: one HTML file that opens offline."""

from __future__ import annotations

import json
from pathlib import Path

from insonify.mission.remap import Remap
from insonify.report import map_pictures
from insonify.report.fans import AS_IT_IS, draw_fan
from insonify.report.html import embed, template


def write_map_report(remap: Remap, path: Path) -> None:
    """Write the report of a map.

    Raises:
        MissingExtraError: The packages for reports are not installed.
    """
    window = remap.mapper.voxels.window(remap.region)
    result = remap.result()
    told = result.to_json()
    page = template("map.html.jinja").render(
        result=result,
        names=", ".join(Path(source["file"]).name for source in result.recordings),
        occupancy=embed(map_pictures.draw_occupancy(window, remap.poses)),
        entropy=embed(map_pictures.draw_entropy(window)),
        slices=embed(map_pictures.draw_slices(window)),
        pings=[
            embed(draw_fan(posed.ping, f"{name}, ping {number}", scale=AS_IT_IS))
            for name, number, posed in remap.keyframes
        ],
        settings=json.dumps(
            {key: told[key] for key in ("mapper", "mapping", "origin_m", "region_m", "fans")},
            indent=2,
        ),
    )
    path.write_text(page, encoding="utf-8")
