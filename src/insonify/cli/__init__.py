"""The command ``insonify``: subcommands, and the one place where errors become messages.

Heavy imports wait until a command needs them, so that ``insonify --help`` is quick.
"""

from __future__ import annotations

import errno
import signal
import sys
import warnings
from typing import Annotated, Any, TextIO, cast

import typer

from insonify.cli.progress import show_log
from insonify.cli.root import EXIT_BAD_INPUT, EXIT_INTERRUPTED, Interrupted, app
from insonify.errors import InsonifyError

# isort: off
# --help lists the commands in this order
from insonify.cli import scans
from insonify.cli import comparisons
from insonify.cli import campaigns
from insonify.cli import recordings
from insonify.cli import checks
from insonify.cli import views
from insonify.cli import explanations
from insonify.cli import reports
from insonify.cli import plans
from insonify.cli import simulation
from insonify.cli import tours
from insonify.cli import datasets
from insonify.cli import exports
from insonify.cli import listings
from insonify.cli import configs
from insonify.cli import warming

# isort: on

__all__ = [
    "app",
    "campaigns",
    "checks",
    "comparisons",
    "configs",
    "datasets",
    "explanations",
    "exports",
    "listings",
    "main",
    "plans",
    "recordings",
    "reports",
    "scans",
    "simulation",
    "tours",
    "views",
    "warming",
]


_UsageError = cast(type[Exception], typer.BadParameter.__bases__[0])
"""What typer raises on a command line that makes no sense; it has no public name for it."""


def _usage(err: Any) -> str:
    """What is wrong with a command line, in one sentence."""
    message = " ".join(err.format_message().split()).removesuffix(".").replace("Value error, ", "")
    given = _given(getattr(err, "param", None))
    if given and given.removeprefix(", not ") in message:
        given = ""
    command = err.ctx.command_path if err.ctx is not None else "insonify"
    return f"{message[:1].lower()}{message[1:]}{given} (see `{command} --help`)"


def _given(param: Any) -> str:
    """What was given for an option, where that was the trouble."""
    words = sys.argv[1:]
    for option in getattr(param, "opts", ()):
        for word, following in zip(words, [*words[1:], ""], strict=True):
            if word == option and following:
                return f", not {following!r}"
            if option.startswith("--") and word.startswith(f"{option}="):
                return f", not {word.removeprefix(f'{option}=')!r}"
    return ""


def _interrupt(signum: int, frame: object) -> None:
    raise Interrupted


def _show_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """A warning as a message for the user, without the line of code that gave it."""
    print(f"insonify: warning: {message}", file=sys.stderr)


def main() -> None:
    """Run the command line; bad input is one sentence and exit code 2."""
    signal.signal(signal.SIGINT, _interrupt)
    warnings.showwarning = _show_warning
    show_log()
    if len(sys.argv) == 1:
        app()  # shows the help
    try:
        sys.exit(app(standalone_mode=False, prog_name="insonify"))
    except _UsageError as err:
        print(f"insonify: {_usage(err)}", file=sys.stderr)
        sys.exit(EXIT_BAD_INPUT)
    except InsonifyError as err:
        print(f"insonify: {err}", file=sys.stderr)
        sys.exit(EXIT_BAD_INPUT)
    except Interrupted:
        print("insonify: interrupted; nothing was written", file=sys.stderr)
        sys.exit(EXIT_INTERRUPTED)
    except OSError as err:
        if err.errno != errno.ENOSPC:
            raise
        print("insonify: the output cannot be written: no space left", file=sys.stderr)
        sys.exit(EXIT_BAD_INPUT)


def _version(wanted: bool) -> None:
    if wanted:
        from insonify import __version__

        print(f"insonify {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    pass
