"""Compiling all kernels ahead of their first use."""

from __future__ import annotations

import json
import sys
from typing import Annotated

import typer

from insonify.cli.progress import compiled_kernels, progress
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

    if as_json:
        print(json.dumps({"kernels": len(KERNELS), "compiled": compiled_kernels()}, indent=2))
    elif not quiet:
        kept = "" if cache_folder() is not None else "; none is kept, as no folder can be written"
        print(f"{len(KERNELS)} kernels, {compiled_kernels()} compiled now{kept}", file=sys.stderr)
