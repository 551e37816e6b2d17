"""The report of a map made from recordings: one HTML file that opens offline."""

from __future__ import annotations

import json
from pathlib import Path

from insonify.config.settings import Table
from insonify.mission.remap import Remap
from insonify.mission.result import MapResult
from insonify.report import colours, map_pictures
from insonify.report.fans import AS_IT_IS, draw_fan
from insonify.report.html import embed, embed_image, template


def write_map_report(remap: Remap, path: Path) -> None:
    """Write the report of a map.

    Raises:
        MissingExtraError: The packages for reports are not installed.
    """
    window = remap.mapper.voxels.overview(remap.region)
    result = remap.result()
    told = result.to_json()
    occupancy = map_pictures.draw_occupancy(window, remap.poses)
    page = template("map.html.jinja").render(
        result=result,
        names=", ".join(Path(source["file"]).name for source in result.recordings),
        colours=colours,
        fans=[_fan(fan) for fan in told["fans"]],
        region=_region(result),
        seen=100.0 * result.region["in_view"] / max(result.region["voxels"], 1),
        occupancy=[(name, embed(image)) for name, image in occupancy],
        entropy=[(name, embed(image)) for name, image in map_pictures.draw_entropy(window)],
        slices=[(name, embed(image)) for name, image in map_pictures.draw_slices(window)],
        pings=[
            (f"{name}, ping {number}", embed_image(draw_fan(posed.ping, "", scale=AS_IT_IS)))
            for name, number, posed in remap.keyframes
        ],
        settings=json.dumps(
            {key: told[key] for key in ("mapper", "mapping", "origin_m", "region_m", "fans")},
            indent=2,
        ),
    )
    path.write_text(page, encoding="utf-8")


def _region(result: MapResult) -> str:
    low, high = result.region_m
    return ", ".join(
        f"{axis} {first:.1f} to {last:.1f} m"
        for axis, first, last in zip("xyz", low, high, strict=True)
    )


def _fan(fan: Table) -> str:
    """A fan as people read it, of `describe_fan`."""
    return (
        f"{fan['azimuth_deg']:g}° across, {fan['elevation_deg']:g}° high, {fan['beams']} beams of "
        f"{fan['bins']} bins, {fan['range_min_m']:g} to {fan['range_max_m']:g} m"
    )
