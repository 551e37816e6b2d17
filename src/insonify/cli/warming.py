"""Compiling all kernels ahead of their first use."""

from __future__ import annotations

from typing import Annotated

import typer

from insonify.cli.printing import say_json, tell
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
        say_json({"kernels": len(KERNELS), "compiled": compiled_kernels()})
    elif not quiet:
        kept = "" if cache_folder() is not None else "; none is kept, as no folder can be written"
        tell(f"{len(KERNELS)} kernels, {compiled_kernels()} compiled now{kept}")
