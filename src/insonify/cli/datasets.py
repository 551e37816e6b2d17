"""Datasets for those who train networks."""

from __future__ import annotations

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
from insonify.names import file_name

if TYPE_CHECKING:
    from insonify.mission.result import DatasetResult


@app.command()
def dataset(
    world: Annotated[
        str | None, typer.Argument(help="A world as `simulate` takes it: file, scenario, name.")
    ] = None,
    count: Annotated[int | None, typer.Option(min=1, help="How many views.")] = None,
    sonar: Annotated[str | None, typer.Option(help="A device; see: sonars")] = None,
    range_m: RangeOption = None,
    model: ModelOption = None,
    renderer: RendererOption = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the poses and the noise.")] = None,
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
    """Make a dataset: many views of a world with the truth of each pixel, Zarr and COCO."""
    begin("starting")
    from insonify.imaging.dataset import dataset_config
    from insonify.io.folders import unused_folder
    from insonify.mission.crew import all_cores
    from insonify.results.dataset import make_dataset

    chosen = choices(
        sonar=absolute(sonar), model=model, renderer=renderer, seed=seed, count=count
    ) | world_table(search, materials)
    full = dataset_config(*world_and_layers(world, config, with_range(settings, range_m), chosen))
    folder = out or unused_folder(Path("insonify-runs") / file_name(f"{full.world_name}-dataset"))
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
