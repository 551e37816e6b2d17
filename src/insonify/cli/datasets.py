"""Datasets for those who train networks."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from insonify.cli.printing import say, say_json, say_listing, tell
from insonify.cli.progress import begin, progress
from insonify.cli.root import (
    EXIT_INTERRUPTED,
    ConfigOption,
    ForceOption,
    JsonOption,
    MaterialsOption,
    ModelOption,
    OutOption,
    RangeOption,
    RendererOption,
    SearchOption,
    SetOption,
    absolute,
    app,
    choices,
    interruptible,
    with_range,
    world_and_layers,
    world_table,
)
from insonify.cli.simulation import McapOption
from insonify.errors import ConfigError
from insonify.names import file_name

if TYPE_CHECKING:
    from insonify.mission.result import DatasetResult


class Format(StrEnum):
    """What a dataset is written as, beside Zarr and COCO."""

    YOLO = "yolo"
    WEBDATASET = "webdataset"


@app.command()
def dataset(
    worlds: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="WORLD...",
            help="Worlds as `simulate` takes them: files, scenarios, names; field@7 has seed 7.",
        ),
    ] = None,
    count: Annotated[int | None, typer.Option(min=1, help="How many views.")] = None,
    sonar: Annotated[str | None, typer.Option(help="A device; see: sonars")] = None,
    range_m: RangeOption = None,
    model: ModelOption = None,
    renderer: RendererOption = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the poses and the noise.")] = None,
    split: Annotated[
        str | None,
        typer.Option(
            metavar="TRAIN/VAL/TEST", help="Shares of the worlds; no world is in two parts."
        ),
    ] = None,
    formats: Annotated[
        list[Format] | None,
        typer.Option(
            "--format", metavar="yolo|webdataset", help="Beside Zarr and COCO; may be repeated."
        ),
    ] = None,
    license: Annotated[
        str | None, typer.Option(metavar="NAME|FILE", help="For its card, as cc-by-4.0.")
    ] = None,
    mcap: McapOption = False,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes; by default one for each core.")
    ] = None,
    search: SearchOption = None,
    materials: MaterialsOption = None,
    settings: SetOption = None,
    config: ConfigOption = None,
    out: OutOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Make a dataset: many views of a world with the truth of each pixel."""
    begin("starting")
    from insonify.imaging.dataset import dataset_config
    from insonify.io.folders import unused_folder
    from insonify.mission.crew import all_cores
    from insonify.results.dataset import make_dataset

    chosen = choices(
        sonar=absolute(sonar), model=model, renderer=renderer, seed=seed, count=count,
        license=absolute(license), split=None if split is None else _shares(split),
        formats=None if formats is None else [one.value for one in dict.fromkeys(formats)],
        more_worlds=[absolute(one) for one in worlds[1:]] if worlds else None,
    ) | world_table(search, materials)  # fmt: skip
    first = worlds[0] if worlds else None
    full = dataset_config(*world_and_layers(first, config, with_range(settings, range_m), chosen))
    folder = out or unused_folder(Path("insonify-runs") / file_name(f"{full.names[0]}-dataset"))
    with (
        interruptible("stopping after the views that are being made") as interrupted,
        progress("views", full.count) as bar,
    ):
        result, target = make_dataset(
            full,
            folder,
            force=force,
            workers=workers or all_cores(),
            mcap=mcap,
            watch=lambda done: bar.show(done, note=f"{done} of {full.count}"),
            should_stop=interrupted,
        )
    if result is None:
        raise typer.Exit(EXIT_INTERRUPTED)
    _tell(result, target, as_json)


def _shares(text: str) -> list[float]:
    """The shares of --split.

    Raises:
        ConfigError: They are no numbers.
    """
    try:
        return [float(word) for word in text.split("/")]
    except ValueError as err:
        raise ConfigError(
            f"--split takes shares for train, val and test, as 80/10/10, not {text!r}"
        ) from err


def _tell(result: DatasetResult, target: Path, as_json: bool) -> None:
    if as_json:
        say_json(result.to_json())
    else:
        _print_result(result)
    tell(f"Dataset: {target}")


def _print_result(result: DatasetResult) -> None:
    rows = [
        [name, str(entry["views"]), f"{entry['pixels']:,}"]
        for name, entry in result.categories.items()
    ]
    say(f"{result.world}: {result.views} views with {result.sonar}")
    say_listing(["category", "views", "pixels"], rows)
    if len(result.parts) > 1:
        parts = [
            [part, f"{told['views']:,}", ", ".join(told["worlds"])]
            for part, told in result.parts.items()
        ]
        say_listing(["part", "views", "worlds"], parts)
