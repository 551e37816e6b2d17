"""Labels of YOLO segmentation: of each view a text file, of each body in it one polygon.

A line is the category's number, from 0, and the corners x y of a polygon, as shares of width and
height.  A polygon is one ring, so the outlines of all parts and holes of a mask are joined by lines
that go there and back and enclose nothing, as those do who convert COCO for YOLO.  It holds the
centres of the mask's pixels and of no others.
"""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path

import numpy as np

from insonify.extras import optional
from insonify.imaging.collection import Collection
from insonify.io.folders import write_file
from insonify.results.dataset.coco import categories_of, file_name, masks_of
from insonify.sonar.truth import Truth
from insonify.types import Array, Bool, Float64

LABELS, DATA = "labels", "data.yaml"


def label_name(number: int) -> str:
    """Of a view's labels: that of its picture, with another suffix, as YOLO finds them."""
    return Path(file_name(number)).with_suffix(".txt").name


def label_text(truth: Truth) -> bytes:
    """A view's labels.

    Raises:
        MissingExtraError: contourpy, which comes with matplotlib, is not installed.
    """
    height, width = truth.label.shape
    lines = []
    for category, mask in masks_of(truth):
        corners = polygon(mask) / (width, height)
        lines.append(f"{category - 1} " + " ".join(f"{x:.6f} {y:.6f}" for x, y in corners))
    return "".join(f"{line}\n" for line in lines).encode()


def polygon(mask: Bool) -> Float64:
    """One ring (N, 2) around the pixels of a mask, x along columns and y along rows, in pixels.

    Pixel (row, column) is the square from (column, row) to (column + 1, row + 1).  The ring runs
    half-way between the centres of a pixel inside and of one outside.
    """
    contourpy = optional("contourpy", "reports", "labels for YOLO")
    around = contourpy.contour_generator(
        z=np.pad(mask, 1).astype(np.float64), fill_type=contourpy.FillType.OuterOffset
    )
    rings = [
        _without_straight_corners(points[begin : end - 1] - 0.5)
        for points, offsets in zip(*around.filled(0.5, 2.0), strict=True)
        for begin, end in pairwise(offsets.tolist())
    ]
    if len(rings) == 1:
        return rings[0]
    there: list[Float64] = []
    way: list[Float64] = []
    for ring in rings:
        upright = np.flatnonzero(ring[:, 1] % 1.0 == 0.0)  # above or below a pixel
        near = ring[upright] - (way[-1] if way else ring[upright[0]])
        ring = np.roll(ring, -upright[int((near**2).sum(axis=1).argmin())], axis=0)
        if way:
            left = way[-1][0] - 0.5  # along the edges of pixels, so that no centre lies on the way
            corners = [np.array([left, way[-1][1]]), np.array([left, ring[0][1]])]
            there += corners
            way += corners
        there += [*ring, ring[0]]
        way.append(ring[0])
    return np.array(there + way[-2:0:-1])


def _without_straight_corners(ring: Float64) -> Float64:
    before, after = ring - np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0) - ring
    turns: Array = before[:, 0] * after[:, 1] != before[:, 1] * after[:, 0]
    return ring[turns]


def write_index(folder: Path, views: Collection, images: str) -> None:
    """Write ``data.yaml``, and of each part the list of its pictures."""
    lines = ["# Of Ultralytics' YOLO: yolo segment train data=data.yaml"]
    for part in views.parts:
        names = (f"./{images}/{file_name(number)}\n" for number in views.numbers(part))
        write_file(folder / f"{part}.txt", "".join(names).encode())
        lines.append(f"{part}: {part}.txt")
    if "val" not in views.parts:
        lines.append("# val: there is none, as no world is set apart; see --split")
    lines.append("names:")
    lines += [f"  {k}: {json.dumps(name)}" for k, name in enumerate(categories_of(views.labels))]
    write_file(folder / DATA, ("\n".join(lines) + "\n").encode())
