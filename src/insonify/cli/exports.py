"""Maps for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from insonify.cli.printing import say, say_json
from insonify.cli.progress import begin
from insonify.cli.root import JsonOption, app, datum_from_text


@app.command()
def export(
    source: Annotated[
        Path, typer.Argument(metavar="MAP", help="Result folder, or .npz, .zarr, .ot, .bt.")
    ],
    target: Annotated[
        Path,
        typer.Argument(
            metavar="OUT", help="Ends in .npz, .zarr, .ot, .bt, .ply, .glb, .stl, .tif, .xyz, .vdb."
        ),
    ],
    datum: Annotated[
        str | None,
        typer.Option(
            metavar="'LAT LON'", help="Where the origin lies, degrees (WGS 84); for .tif."
        ),
    ] = None,
    epsg: Annotated[
        int | None,
        typer.Option(
            metavar="CODE", min=1024, max=32767, help="Reference system of x and y; for .tif."
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace OUT.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Write a map in the format of another program; OUT's suffix names it."""
    begin("starting")
    from insonify.io.folders import result_file
    from insonify.io.maps import load_map, save_map
    from insonify.mapping.voxels import OBSERVED

    place = datum_from_text(datum) if datum is not None else None
    voxels = load_map(source)
    with result_file(target, force=force) as scratch:
        save_map(voxels, scratch, datum=place, epsg=epsg)
    files = [path for path in (target, *target.rglob("*")) if path.is_file()]
    row = {
        "file": str(target),
        "bytes": sum(path.stat().st_size for path in files),
        "voxel_m": voxels.voxel_m,
        "observed_voxels": int(((voxels.seen & OBSERVED) > 0).sum()),
        "occupied_voxels": int((voxels.log_odds > 0).sum()),
    }
    if as_json:
        say_json(row)
    else:
        say(
            f"{target}: {row['bytes']:,} bytes, from {row['observed_voxels']:,} observed voxels of "
            f"{voxels.voxel_m:g} m, {row['occupied_voxels']:,} of them occupied"
        )
