"""The report: one HTML file that opens offline and can be sent to a colleague."""

from __future__ import annotations

import base64
import io
import json
import tomllib
import zlib
from importlib import resources
from pathlib import Path
from typing import Any

import jinja2
from PIL import Image

from insonify.mission.account import Account
from insonify.report import colours, courses, flights, pictures, scene3d, scores, summary
from insonify.report.fans import draw_fan, scale_of

_WIDE_IN, _NARROW_IN = 10.4, 4.4
_WEBP_QUALITY = 90


def write_report(account: Account, path: Path) -> None:
    """Write the report of a scan, of its run or of its files.

    Raises:
        MissingExtraError: The packages for reports are not installed.
    """
    result = account.result
    page = template("report.html.jinja").render(
        result=result,
        lead=summary.lead(account),
        facts=summary.facts(account),
        colours=colours,
        courses=_courses(account),
        long=courses.is_long(account),
        flight=_flight(account),
        decisions=_decisions(account),
        pings=_pings(account),
        slices=[(name, embed(image)) for name, image in pictures.draw_slices(account)],
        history=[
            (scores.ALONG[along], embed(scores.draw_scores(result, along)))
            for along in scores.ALONG
            if getattr(result.history[-1], along) is not None
        ],
        losses=scores.losses(result.history),
        entropy=embed(scores.draw_entropy_left(result)),
        traces=packed(json.dumps([scene3d.traces(account), scene3d.layout(account)])),
        config=account.config_toml,
        plotly=packed(_plotly()),
    )
    path.write_text(page, encoding="utf-8")


def template(name: str) -> jinja2.Template:
    """A template of this room."""
    loader = jinja2.PackageLoader("insonify", "report")
    return jinja2.Environment(loader=loader, autoescape=True, trim_blocks=True).get_template(name)


def embed(png: bytes) -> str:
    """A drawing as an address that holds it, in as many colours as a palette has."""
    with Image.open(io.BytesIO(png)) as picture:
        few = picture.convert("RGB").quantize(256, dither=Image.Dither.NONE)
    return _address(few, "png", optimize=True)


def embed_image(png: bytes) -> str:
    """A sonar image as an address that holds it; its speckle is compressed as photographs are."""
    with Image.open(io.BytesIO(png)) as picture:
        return _address(picture.convert("RGB"), "webp", quality=_WEBP_QUALITY)


def _address(picture: Image.Image, kind: str, **how: Any) -> str:
    stream = io.BytesIO()
    picture.save(stream, kind, **how)
    return f"data:image/{kind};base64," + base64.b64encode(stream.getvalue()).decode()


def packed(text: str) -> str:
    """Text as browsers unpack it (``DecompressionStream("deflate")``), in base64."""
    return base64.b64encode(zlib.compress(text.encode(), 9)).decode()


def _plotly() -> str:
    bundle = resources.files("plotly").joinpath("package_data/plotly.min.js")
    return bundle.read_text(encoding="utf-8")


def _courses(account: Account) -> list[dict[str, str]]:
    """The course from above and from the side, each drawn for a desk and for a phone."""
    side = courses.side_of(account)
    long = courses.is_long(account)
    return [
        {
            "name": name,
            "wide": embed(courses.draw_course(account, view, _WIDE_IN if long else 5.4)),
            "narrow": embed(courses.draw_course(account, view, _NARROW_IN)),
        }
        for name, view in (
            ("From above", courses.ABOVE),
            ("From the south" if side.across == 0 else "From the east", side),
        )
    ]


def _flight(account: Account) -> dict[str, Any] | None:
    """The pictures of a flight, if there was one."""
    if not account.moments:
        return None
    moments = list(account.moments)
    return {
        "tracks": [embed(picture) for picture in flights.draw_tracks(account, moments)],
        "errors": [(name, embed(drawn)) for name, drawn in flights.draw_pose_errors(moments)],
    }


def _decisions(account: Account) -> list[dict[str, Any]]:
    """Those made on a map, if their reasons are known or they are the entropy planner's."""
    made = [record for record in account.decisions if record.entropy_bits is not None]
    return [
        {
            "after": after,
            "decision": record.decision,
            "offer": summary.offer(record.decision),
            "undecided": embed(pictures.draw_undecided(account, record)),
            "candidates": None
            if record.decision.look is None
            else embed(pictures.draw_candidates(record)),
        }
        for after, record in enumerate(made, 1)
        if record.decision.look is not None or account.result.planner == "entropy"
    ]


def _pings(account: Account) -> list[tuple[str, str]]:
    """Sonar images with a word on each."""
    config = tomllib.loads(account.config_toml)
    scale = scale_of(config["model"], config["sonar"]["display_gamma"])
    found = []
    for scan, posed in account.keyframes:
        assert posed.pose is not None
        where = f"scan {scan}, at ({posed.pose.x_m:.1f}, {posed.pose.y_m:.1f}) m"
        found.append((where, embed_image(draw_fan(posed.ping, "", scale=scale))))
    return found
