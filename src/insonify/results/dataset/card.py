"""What a dataset tells of itself: a card as the Hugging Face hub reads it, and its statistics."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from insonify import __version__
from insonify.errors import MissingExtraError
from insonify.imaging.collection import Collection
from insonify.imaging.dataset import standoffs_m
from insonify.io.folders import write_file
from insonify.results.dataset.coco import SLICES, categories_of
from insonify.results.dataset.licences import LICENSE, licence_of

CARD, STATISTICS = "README.md", "statistics.png"
_HUB = {"train": "train", "val": "validation", "test": "test"}
"""What the hub calls the parts."""
_SIZES = ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"))
_SIZE_STEPS = 24

_log = logging.getLogger(__name__)


class Counts:
    """What is counted of a dataset, view after view.

    Attributes:
        views: (parts, categories) how many views of a part show a category.
        total: (parts,) how many views it has.
        pixels: (categories,) how many show it.
    """

    def __init__(self, of: Collection, rows: Iterable[dict[str, Any]]) -> None:
        """Count.

        Args:
            of: The dataset.
            rows: What `coco.row` said of each view, in order.
        """
        self.of, self.names = of, categories_of(of.labels)
        parts, count = len(of.parts), len(self.names)
        self.views = np.zeros((parts, count), np.int64)
        self.total = np.zeros(parts, np.int64)
        self.pixels = np.zeros(count, np.int64)
        self.ranges = np.zeros((count, SLICES), np.int64)
        self.sizes = np.zeros((count, _SIZE_STEPS), np.int64)
        self.levels = np.zeros(SLICES, np.int64)
        self.places: list[tuple[float, float, int]] = []
        for number, said in enumerate(rows):
            self._add(of.parts.index(of.part(number)), said)

    def _add(self, part: int, said: dict[str, Any]) -> None:
        bins, beams = said["size"]
        self.total[part] += 1
        self.levels += said["levels"]
        self.places.append((*said["pose"][:2], part))
        shown = sorted({one["mask"]["category_id"] - 1 for one in said["found"]})
        self.views[part, shown] += 1
        for one in said["found"]:
            k, area = one["mask"]["category_id"] - 1, one["mask"]["area"]
            step = int(_SIZE_STEPS * (1.0 + np.log10(area / (bins * beams)) / 6.0))
            self.pixels[k] += area
            self.ranges[k] += one["ranges"]
            self.sizes[k, min(max(step, 0), _SIZE_STEPS - 1)] += 1

    @property
    def categories(self) -> dict[str, dict[str, int]]:
        """In how many views each category is, and how many pixels show it."""
        seen = self.views.sum(axis=0).tolist()
        return {
            name: {"views": views, "pixels": pixels}
            for name, views, pixels in zip(self.names, seen, self.pixels.tolist(), strict=True)
        }


def write_card(folder: Path, counts: Counts, tables: Iterable[tuple[str, str]]) -> None:
    """Write the card, the text of the licence if it is the user's own, and the statistics.

    Args:
        folder: Of the dataset.
        counts: Of it.
        tables: Names of what is in the folder, and what that is.
    """
    licence = licence_of(counts.of.config.license)
    if licence is not None and licence.text:
        write_file(folder / LICENSE, licence.text.encode())
    pictured = _draw(folder / STATISTICS, counts)
    lines = ["---", *_front_matter(counts), "---", "", *_text(counts, pictured, list(tables))]
    write_file(folder / CARD, ("\n".join(lines) + "\n").encode())


def _draw(path: Path, counts: Counts) -> bool:
    """The statistics picture; a dataset is whole without it too, and the log says what lacks."""
    try:
        from insonify.report.dataset_pictures import DatasetFigures, draw_statistics
    except MissingExtraError as err:
        _log.warning("no picture of the statistics is drawn: %s", err)
        return False
    fan = counts.of.geometry
    figures = DatasetFigures(
        title=_title(counts.of),
        categories=counts.names,
        parts=counts.of.parts,
        range_m=(fan.range_min_m, fan.range_max_m),
        views=counts.views,
        total=counts.total,
        pixels=counts.pixels,
        sizes=counts.sizes,
        ranges=counts.ranges,
        levels=counts.levels,
        places=counts.places,
    )
    write_file(path, draw_statistics(figures))
    return True


def _title(of: Collection) -> str:
    worlds = of.config.names
    where = ", ".join(worlds[:3]) + (f" and {len(worlds) - 3} more" if len(worlds) > 3 else "")
    return of.config.title or f"Sonar images of {where}"


def _front_matter(counts: Counts) -> Iterator[str]:
    """YAML; its scalars are JSON's, which are YAML's too."""
    config = counts.of.config
    licence = licence_of(config.license)
    yield f"license: {licence.key if licence else 'unknown'}"
    if licence is not None and licence.text:
        yield f"license_name: {json.dumps(licence.name)}"
        yield f"license_link: {licence.link}"
    yield f"pretty_name: {json.dumps(_title(counts.of))}"
    yield "task_categories:"
    yield from ("- image-segmentation", "- object-detection")
    yield "tags:"
    yield from ("- sonar", "- imaging-sonar", "- underwater", "- synthetic", "- insonify")
    yield "size_categories:"
    yield f"- {next((name for most, name in _SIZES if config.count < most), 'n=1M')}"
    if "webdataset" in config.formats:
        yield "configs:"
        yield "- config_name: default"
        yield "  data_files:"
        for part in counts.of.parts:
            yield f"  - split: {_HUB[part]}"
            yield f"    path: shards/{part}-*.tar"


def _text(counts: Counts, pictured: bool, tables: list[tuple[str, str]]) -> Iterator[str]:
    config = counts.of.config
    worlds = len(config.worlds)
    yield f"# {_plain(_title(counts.of))}"
    yield ""
    yield (
        f"{config.count:,} simulated views of {worlds} {'world' if worlds == 1 else 'worlds'} with "
        "a forward-looking sonar, each with what every pixel shows. Made by insonify "
        f"{__version__} with seed {config.seed}; `insonify dataset --config config.toml` makes the "
        "same bytes again."
    )
    yield ""
    if pictured:
        yield f"![How often, how large and how far away each category is]({STATISTICS})"
        yield ""
    yield from _table(("sonar", ""), _sonar(counts.of))
    yield from ("## Parts", "", "No world is in two parts.", "")
    yield from _table(("part", "views", "worlds"), _parts(counts))
    yield from ("## Categories", "")
    yield from _table(("category", "views", "pixels", "of all pixels"), _categories(counts))
    yield from ("## Files", "")
    yield from _table(("file", "what it is"), [(f"`{name}`", what) for name, what in tables])
    yield from ("## Licence", "")
    licence = licence_of(config.license)
    yield (
        "None is chosen yet (`--license`), so nobody but its owner may use it."
        if licence is None
        else f"[{_plain(licence.name)}]({licence.link})"
    )


def _sonar(of: Collection) -> Iterator[tuple[str, ...]]:
    config, fan = of.config, of.geometry
    wide, high = np.degrees([fan.azimuth_fov_rad, fan.elevation_fov_rad])
    near_m, far_m = standoffs_m(config)
    yield "device", _plain(config.sonar.name)
    yield "image model, renderer", f"{config.model}, {config.renderer}"
    yield "field of view", f"{wide:.3g}° x {high:.3g}° (azimuth x elevation)"
    yield "image", f"{fan.bins} range bins x {fan.beams} beams, port on the left"
    yield "range", f"{fan.range_min_m:g} to {fan.range_max_m:g} m"
    yield "distance to what is looked at", f"{near_m:.3g} to {far_m:.3g} m"


def _parts(counts: Counts) -> Iterator[tuple[str, ...]]:
    config = counts.of.config
    for part, views in zip(counts.of.parts, counts.total.tolist(), strict=True):
        worlds = [
            _plain(name)
            for name, its in zip(config.names, config.parts, strict=True)
            if its == part
        ]
        yield part, f"{views:,}", ", ".join(worlds)


def _categories(counts: Counts) -> Iterator[tuple[str, ...]]:
    fan = counts.of.geometry
    whole = counts.of.config.count * fan.bins * fan.beams
    for name, one in counts.categories.items():
        share = f"{100 * one['pixels'] / whole:.3g} %"
        yield _plain(name), f"{one['views']:,}", f"{one['pixels']:,}", share


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> Iterator[str]:
    yield f"| {' | '.join(head)} |"
    yield f"|{'---|' * len(head)}"
    for row in rows:
        yield f"| {' | '.join(row)} |"
    yield ""


def _plain(text: str) -> str:
    """A name as Markdown shows it, and nothing more."""
    return "".join(f"\\{letter}" if letter in "\\`*_[]<>|#&" else letter for letter in text)
