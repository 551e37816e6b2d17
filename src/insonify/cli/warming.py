"""Compiling all kernels ahead of their first use."""

from __future__ import annotations

import json
import sys
from typing import Annotated

import typer

from insonify.cli.progress import progress
from insonify.cli.root import JsonOption, app


@app.command("warm-up")
def warm_up(
    as_json: JsonOption = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Say nothing when it is done.")] = False,
) -> None:
    """Compile all kernels now, so that no command has to later."""
    from insonify.warmup import STEPS, warm_up_step

    with progress("compiling kernels", len(STEPS)) as bar:
        for number, name in enumerate(STEPS):
            bar.show(number, name=f"compiling kernels: {name}")
            warm_up_step(name)
    from insonify.jit import KERNELS, cache_folder

    compiled = sum(1 for one in KERNELS if one.signatures)
    if as_json:
        print(json.dumps({"kernels": len(KERNELS), "compiled": compiled}, indent=2))
    elif not quiet:
        where = "nowhere, as no folder can be written" if cache_folder() is None else "on disk"
        print(
            f"{compiled} of {len(KERNELS)} kernels are compiled and kept {where}", file=sys.stderr
        )
