"""The report of a map made from recordings: one HTML file that opens offline."""

from __future__ import annotations

import base64
import json
from pathlib import Path

import jinja2

from insonify.replay import Replay
from insonify.report import map_pictures
from insonify.report.fans import draw_fan


def write_map_report(replay: Replay, path: Path) -> None:
    """Write the report of a replay."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("insonify", "report"), autoescape=True, trim_blocks=True
    )
    window = replay.mapper.voxels.window(replay.region)
    result = replay.result()
    page = environment.get_template("map.html.jinja").render(
        result=result,
        names=", ".join(Path(source["file"]).name for source in result["recordings"]),
        occupancy=_embed(map_pictures.draw_occupancy(window, replay.poses)),
        entropy=_embed(map_pictures.draw_entropy(window)),
        slices=_embed(map_pictures.draw_slices(window)),
        pings=[
            _embed(draw_fan(recorded.ping, f"{name}, ping {number}"))
            for name, number, recorded in replay.keyframes
        ],
        settings=json.dumps(
            {key: result[key] for key in ("mapping", "region_m", "fans")}, indent=2
        ),
    )
    path.write_text(page, encoding="utf-8")


def _embed(png: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(png).decode()
