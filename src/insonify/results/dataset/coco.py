"""Annotations in COCO's format, and the pictures that they are of.

Pictures are polar as the arrays are: a row is a range bin, the nearest on top, a column is a beam,
port on the left.  Masks are COCO's run-length encoding: runs of 0 and 1 by turns, down the columns.
"""

from __future__ import annotations

import io
import json
import math
import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from insonify.imaging.collection import Collection
from insonify.imaging.route import Shot
from insonify.results.dataset.licences import licence_of
from insonify.sonar.truth import Truth, label_colours
from insonify.types import Array, Bool, Ping

SHADOW = "shadow"
SLICES = 20
"""Of range and of intensity, in which pixels are counted for the dataset's statistics."""
_NUMBERED = re.compile(r"#\d+$")
MOST_LABELS = 254
"""A mask has a byte a pixel, and needs two values for nothing and shadow."""


def file_name(number: int) -> str:
    """Of a view's picture and of its mask."""
    return f"{number:06d}.png"


def image_png(ping: Ping) -> bytes:
    """A sonar image, (bins, beams) grey."""
    grey = np.round(np.clip(ping.image, 0.0, 1.0) * 255.0).astype(np.uint8)
    return _png(Image.fromarray(grey))


def mask_png(truth: Truth) -> bytes:
    """The category of each pixel: 0 none, and last shadow; with a palette."""
    picture = Image.fromarray(category_pixels(truth))
    colours = np.zeros((256, 3), np.uint8)
    count = len(categories_of(truth.labels)) - 1
    colours[1 : count + 1] = np.round(255 * label_colours(count))
    colours[count + 1] = (70, 70, 90)
    picture.putpalette(colours.tobytes())
    return _png(picture)


def category_of(label: str) -> str:
    """What kind of thing a body is: ``tower`` of ``tower#2``, the second of a field."""
    return _NUMBERED.sub("", label)


def categories_of(labels: Iterable[str]) -> list[str]:
    """The names of categories 1, 2...: the kinds of bodies, and last what is in shadow."""
    return [*dict.fromkeys(map(category_of, labels)), SHADOW]


def category_pixels(truth: Truth) -> Array:
    """The category of each pixel, (bins, beams) uint8: 0 for none."""
    numbers = np.zeros(truth.label.shape, np.uint8)
    for category, mask in masks_of(truth):
        numbers[mask] = category
    return numbers


def masks_of(truth: Truth) -> Iterator[tuple[int, Bool]]:
    """Of each body that a view shows the number of its category and its pixels; then the shadow."""
    names = categories_of(truth.labels)
    lit = np.where(truth.shadow, -1, truth.label)
    for body in np.unique(lit[lit >= 0]).tolist():
        yield 1 + names.index(category_of(truth.labels[body])), lit == body
    if truth.shadow.any():
        yield len(names), truth.shadow


def row(shot: Shot) -> dict[str, Any]:
    """What is said of a view: its pose, and each body's mask in it.

    Beside a mask stand its pixels by `SLICES` of range, the nearest first; beside all, those of the
    image by slices of intensity.
    """
    assert shot.truth is not None
    assert shot.posed.pose is not None
    bins, beams = shot.truth.label.shape
    slices = np.arange(bins) * SLICES // bins
    bright = np.clip(shot.posed.ping.image, 0.0, 1.0)
    found = []
    for category, mask in masks_of(shot.truth):
        by_range = np.bincount(slices, mask.sum(axis=1), SLICES).astype(int).tolist()
        found.append({"ranges": by_range, "mask": {"category_id": category} | _annotation(mask)})
    return {
        "pose": shot.posed.pose.numbers,
        "size": [bins, beams],
        "levels": np.histogram(bright, SLICES, (0.0, 1.0))[0].tolist(),
        "found": found,
    }


def write_annotations(
    path: Path, views: Collection, rows: Callable[[], Iterable[dict[str, Any]]], part: str = ""
) -> None:
    """Write the annotations of all views, one after another, since they may be many.

    Args:
        path: The file; it appears whole or not at all.
        views: The dataset.
        rows: What `row` said of each view, in order, to be gone through twice.
        part: Only the views of it.
    """
    names = categories_of(views.labels)
    scratch = path.with_name(f".{path.name}.part")

    def chosen() -> Iterator[tuple[int, dict[str, Any]]]:
        for number, said in enumerate(rows()):
            if part in ("", views.part(number)):
                yield number, said

    with scratch.open("w", encoding="utf-8") as file:
        head = json.dumps(
            {"info": _info(views), "licenses": _licenses(views), "categories": _categories(names)}
        )
        file.write(head.removesuffix("}") + ', "images": [')
        for count, (number, said) in enumerate(chosen()):
            file.write((",\n" if count else "\n") + json.dumps(_image(views, number, said)))
        file.write('\n], "annotations": [')
        count = 0
        for number, said in chosen():
            for one in said["found"]:
                note = {"id": count + 1, "image_id": number, "iscrowd": 0} | one["mask"]
                file.write((",\n" if count else "\n") + json.dumps(note))
                count += 1
        file.write("\n]}\n")
    scratch.replace(path)


def _info(views: Collection) -> dict[str, str]:
    config = views.config
    about = (
        f"{', '.join(config.worlds)}, {config.sonar.name}, {config.model}, seed {config.seed}; "
        "polar images: rows are range bins, nearest on top, columns are beams, port on the left"
    )
    return {"description": about, "version": "1"}


def _licenses(views: Collection) -> list[dict[str, Any]]:
    told = licence_of(views.config.license)
    return [] if told is None else [{"id": 1, "name": told.name, "url": told.link}]


def _categories(names: list[str]) -> list[dict[str, Any]]:
    return [{"id": k, "name": name, "supercategory": "sonar"} for k, name in enumerate(names, 1)]


def _image(views: Collection, number: int, said: dict[str, Any]) -> dict[str, Any]:
    bins, beams = said["size"]
    licensed = {"license": 1} if views.config.license else {}
    return {
        "id": number,
        "file_name": f"images/{file_name(number)}",
        "width": beams,
        "height": bins,
        "world": views.config.names[views.world(number)],
        "split": views.part(number),
        "pose_m_deg": pose_m_deg(said),
    } | licensed


def pose_m_deg(said: dict[str, Any]) -> list[float]:
    """Where a view of `row` was taken: x, y, z, roll, pitch, yaw."""
    pose = said["pose"]
    return [*pose[:3], *map(math.degrees, pose[3:])]


def _annotation(mask: Bool) -> dict[str, Any]:
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    left, top = int(columns[0]), int(rows[0])
    return {
        "bbox": [left, top, int(columns[-1]) - left + 1, int(rows[-1]) - top + 1],
        "area": int(mask.sum()),
        "segmentation": {"size": list(mask.shape), "counts": run_lengths(mask)},
    }


def run_lengths(mask: Bool) -> list[int]:
    """Lengths of runs of 0 and 1 by turns down the columns, the first of 0, perhaps of none."""
    flat = np.concatenate([[False], mask.ravel(order="F"), [False]])
    edges = np.flatnonzero(flat[1:] != flat[:-1])
    counts = np.diff(np.concatenate([[0], edges, [mask.size]]))
    return [int(count) for count in (counts[:-1] if counts[-1] == 0 else counts)]


def _png(picture: Image.Image) -> bytes:
    stream = io.BytesIO()
    picture.save(stream, format="png")
    return stream.getvalue()
