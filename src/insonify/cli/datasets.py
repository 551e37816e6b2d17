"""Datasets for those who train networks."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from insonify.cli.root import (
    EXIT_INTERRUPTED,
    ConfigOption,
    ForceOption,
    JsonOption,
    MaterialsOption,
    ModelOption,
    OutOption,
    RendererOption,
    SearchOption,
    SetOption,
    app,
    choices,
    interruptible,
    print_listing,
    stderr,
    world_and_layers,
)
from insonify.errors import MemoryLimitError, OutputError

if TYPE_CHECKING:
    from insonify.datasets import Dataset


@app.command()
def dataset(
    world: Annotated[
        str | None, typer.Argument(help="A world as `simulate` takes it: file, scenario, name.")
    ] = None,
    count: Annotated[int | None, typer.Option(min=1, help="How many views.")] = None,
    sonar: Annotated[str | None, typer.Option(help="A device; see: sonars")] = None,
    model: ModelOption = None,
    renderer: RendererOption = None,
    seed: Annotated[int | None, typer.Option(help="Seed of the poses and the noise.")] = None,
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
    from insonify.datasets import dataset_config
    from insonify.io.configs import dataset_to_toml
    from insonify.io.datasets import DONE, all_cores, write_dataset
    from insonify.io.folders import result_folder, unused_folder
    from insonify.io.unfinished import OWNER, claim, find_unfinished
    from insonify.scene.materials import read_materials

    device = {"preset": sonar} if sonar else None
    chosen = choices(sonar=device, model=model, renderer=renderer, seed=seed, count=count)
    full = dataset_config(*world_and_layers(world, config, settings, chosen))
    table = read_materials(materials) if materials else None
    folder = out or unused_folder(Path("insonify-runs") / f"{Path(full.world).stem}-dataset")
    text = dataset_to_toml(full) + _beside(search, materials)
    before = find_unfinished(folder, text, DONE)
    with (
        result_folder(folder, force=force) as place,
        interruptible("stopping after the views that are being made") as interrupted,
    ):
        if before is not None:
            before.replace(place.scratch)
        claim(place.scratch, text)
        try:
            with _progress(full) as watch:
                seen = write_dataset(
                    full,
                    place.scratch,
                    workers=workers or all_cores(),
                    search=tuple(search or ()),
                    materials=table,
                    watch=watch,
                    should_stop=interrupted,
                )
        except (OSError, OutputError, MemoryLimitError):
            _keep(place.scratch, full.count)
            raise
        if seen is None:
            _keep(place.scratch, full.count)
            raise typer.Exit(EXIT_INTERRUPTED)
        (place.scratch / OWNER).unlink()
    result = {
        "world": full.world,
        "sonar": full.sonar.name,
        "seed": full.seed,
        "views": full.count,
        "categories": seen,
    }
    if as_json:
        print(json.dumps(result, indent=2))
    else:
        _print_result(result)
    print(f"Dataset: {place.target}", file=sys.stderr)


def _beside(search: list[Path] | None, materials: Path | None) -> str:
    """What a dataset depends on that is no setting, as comments below its settings."""
    lines = [f"models looked for in {folder}" for folder in search or ()]
    if materials is not None:
        lines += ["materials:", *materials.read_text(encoding="utf-8").splitlines()]
    return "".join(f"# {line}".rstrip() + "\n" for line in lines)


def _keep(scratch: Path, count: int) -> None:
    """Leave what is whole for the same command to go on with."""
    from insonify.io.datasets import DONE

    kept = scratch.with_name(f"{scratch.name}-kept")
    scratch.replace(kept)
    done = sum(1 for _ in (kept / DONE).glob("*.json"))
    print(
        f"insonify: stopped after {done} of {count} views; the same command goes on from there",
        file=sys.stderr,
    )


@contextmanager
def _progress(config: Dataset) -> Iterator[Callable[[int], None]]:
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    console = stderr()
    with Progress(
        *columns, TimeElapsedColumn(), TimeRemainingColumn(), console=console, transient=True,
        disable=not console.is_terminal,
    ) as bar:  # fmt: skip
        task = bar.add_task("views", total=config.count)
        yield lambda done: bar.update(task, completed=done)


def _print_result(result: dict[str, Any]) -> None:
    rows = [
        [name, str(entry["views"]), f"{entry['pixels']:,}"]
        for name, entry in result["categories"].items()
    ]
    print(f"{result['world']}: {result['views']} views with {result['sonar']}")
    print_listing(["category", "views", "pixels"], rows)
