"""Annotations in COCO's format, and the pictures that they are of.

Pictures are polar as the arrays are: a row is a range bin, the nearest on top, a column is a beam,
port on the left.  Masks are COCO's run-length encoding: runs of 0 and 1 by turns, down the columns.
"""

from __future__ import annotations

import io
import json
import math
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from insonify.imaging.dataset import Shots
from insonify.imaging.route import Shot
from insonify.sonar.truth import Truth, label_colours
from insonify.types import Array, Bool, Ping

SHADOW = "shadow"
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
    """What each pixel shows: 0 nothing, k + 1 label k, and last shadow; with a palette."""
    numbers = category_pixels(truth)
    picture = Image.fromarray(numbers)
    colours = np.zeros((256, 3), np.uint8)
    count = len(truth.labels)
    colours[1 : count + 1] = np.round(255 * label_colours(count))
    colours[count + 1] = (70, 70, 90)
    picture.putpalette(colours.tobytes())
    return _png(picture)


def category_pixels(truth: Truth) -> Array:
    """The category of each pixel, (bins, beams) uint8: 0 for none."""
    numbers = (truth.label + 1).astype(np.uint8)
    numbers[truth.shadow] = len(truth.labels) + 1
    return numbers


def row(shot: Shot) -> dict[str, Any]:
    """What is said of a view: its pose, and each category's mask in it."""
    assert shot.truth is not None
    assert shot.posed.pose is not None
    numbers = category_pixels(shot.truth)
    bins, beams = numbers.shape
    return {
        "pose": shot.posed.pose.numbers,
        "size": [bins, beams],
        "masks": [
            {"category_id": int(k)} | _annotation(numbers == k) for k in np.unique(numbers) if k
        ],
    }  # fmt: skip


def write_annotations(
    path: Path, shots: Shots, rows: Callable[[], Iterable[dict[str, Any]]]
) -> dict[str, dict[str, int]]:
    """Write the annotations of all views, one after another, since they may be many.

    Args:
        path: The file; it appears whole or not at all.
        shots: The dataset.
        rows: What `row` said of each view, in order, to be gone through twice.

    Returns:
        In how many views each category is, and how many pixels show it.
    """
    names = [*shots.scene.labels, SHADOW]
    seen = {name: {"views": 0, "pixels": 0} for name in names}
    scratch = path.with_name(f".{path.name}.part")
    with scratch.open("w", encoding="utf-8") as file:
        head = json.dumps({"info": _info(shots), "licenses": [], "categories": _categories(names)})
        file.write(head.removesuffix("}") + ', "images": [')
        for number, said in enumerate(rows()):
            file.write((",\n" if number else "\n") + json.dumps(_image(number, said)))
        file.write('\n], "annotations": [')
        count = 0
        for number, said in enumerate(rows()):
            for mask in said["masks"]:
                note = {"id": count + 1, "image_id": number, "iscrowd": 0} | mask
                file.write((",\n" if count else "\n") + json.dumps(note))
                entry = seen[names[mask["category_id"] - 1]]
                entry["views"] += 1
                entry["pixels"] += mask["area"]
                count += 1
        file.write("\n]}\n")
    scratch.replace(path)
    return seen


def _info(shots: Shots) -> dict[str, str]:
    config = shots.config
    about = (
        f"{config.world}, {config.sonar.name}, {config.model}, seed {config.seed}; polar images: "
        "rows are range bins, nearest on top, columns are beams, port on the left"
    )
    return {"description": about, "version": "1"}


def _categories(names: list[str]) -> list[dict[str, Any]]:
    return [{"id": k, "name": name, "supercategory": "sonar"} for k, name in enumerate(names, 1)]


def _image(number: int, said: dict[str, Any]) -> dict[str, Any]:
    bins, beams = said["size"]
    pose = said["pose"]
    return {
        "id": number,
        "file_name": f"images/{file_name(number)}",
        "width": beams,
        "height": bins,
        "pose_m_deg": [*pose[:3], *map(math.degrees, pose[3:])],
    }


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
