"""Maps and runs for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from insonify.cli.printing import say, say_json
from insonify.cli.progress import begin, progress
from insonify.cli.recordings import box_from_text
from insonify.cli.root import JsonOption, MemoryOption, app, datum_from_text, memory_limit
from insonify.errors import OutputError

if TYPE_CHECKING:
    from insonify.mapping.voxels import VoxelMap

RERUN = ".rrd"


@app.command()
def export(
    source: Annotated[
        Path, typer.Argument(metavar="RUN", help="Result folder, or .npz, .zarr, .ot, .bt.")
    ],
    target: Annotated[
        Path,
        typer.Argument(
            metavar="OUT",
            help="Ends in .npz, .zarr, .ot, .bt, .ply, .glb, .stl, .tif, .xyz, .vdb, or .rrd.",
        ),
    ],
    datum: Annotated[
        str | None,
        typer.Option(
            metavar="'LAT LON'", help="Where the origin lies, degrees (WGS 84); for .tif."
        ),
    ] = None,
    region: Annotated[
        str | None,
        typer.Option(metavar="'X0 Y0 Z0 X1 Y1 Z1'", help="Only the blocks that touch this box."),
    ] = None,
    memory: MemoryOption = None,
    epsg: Annotated[
        int | None,
        typer.Option(
            metavar="CODE", min=1024, max=32767, help="Reference system of x and y; for .tif."
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace OUT.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Write a map, or for .rrd a run with its pings, for another program; OUT's suffix names it."""
    begin("starting")
    from insonify.io.folders import result_file
    from insonify.io.maps import load_map, save_map

    place = datum_from_text(datum) if datum is not None else None
    if target.suffix == RERUN:
        if place is not None or epsg is not None:
            raise OutputError(f"{target.name}: only a GeoTIFF (.tif) takes a datum or EPSG code")
        if region is not None or memory is not None:
            raise OutputError(f"{target.name}: --region and --memory are for maps, not for a run")
        voxels = _to_rerun(source, target, force)
    else:
        box = None if region is None else box_from_text(region)
        voxels = load_map(source, box, memory_bytes=memory_limit(memory))
        with result_file(target, force=force) as scratch:
            save_map(voxels, scratch, datum=place, epsg=epsg)
    files = [path for path in (target, *target.rglob("*")) if path.is_file()]
    row = {
        "file": str(target),
        "bytes": sum(path.stat().st_size for path in files),
        "voxel_m": voxels.voxel_m,
    } | _counted(voxels)
    if as_json:
        say_json(row)
    else:
        say(
            f"{target}: {row['bytes']:,} bytes, from {row['observed_voxels']:,} observed voxels of "
            f"{voxels.voxel_m:g} m, {row['occupied_voxels']:,} of them occupied"
        )


def _counted(voxels: VoxelMap) -> dict[str, int]:
    """How many voxels are observed, and occupied."""
    from insonify.mapping.voxels import OBSERVED

    observed = occupied = 0
    for part in voxels.parts():
        observed += int(((part.seen & OBSERVED) > 0).sum())
        occupied += int((part.log_odds > 0).sum())
    return {"observed_voxels": observed, "occupied_voxels": occupied}


def _to_rerun(source: Path, target: Path, force: bool) -> VoxelMap:
    from insonify.io.folders import result_file
    from insonify.results.rerun import save_rerun

    with result_file(target, force=force) as scratch, progress("opening") as bar:
        return save_rerun(
            source,
            scratch,
            lambda done, count: bar.show(done, count, "mapping again", f"{done} of {count}"),
        )
