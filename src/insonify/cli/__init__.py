"""The command ``insonify``: subcommands, and the one place where errors become messages.

Heavy imports wait until a command needs them, so that ``insonify --help`` is quick.
"""

from __future__ import annotations

import errno
import io
import os
import signal
import sys
import warnings
from typing import Annotated, Any, NoReturn, TextIO, cast

import typer

from insonify.cli.printing import ReaderGoneError, say, tell
from insonify.cli.progress import show_log
from insonify.cli.root import EXIT_BAD_INPUT, EXIT_BROKEN_PIPE, EXIT_INTERRUPTED, Interrupted, app
from insonify.errors import InsonifyError, reason
from insonify.memory import free_bytes

# isort: off
# --help lists the commands in this order
from insonify.cli import scans
from insonify.cli import comparisons
from insonify.cli import campaigns
from insonify.cli import recordings
from insonify.cli import live
from insonify.cli import checks
from insonify.cli import views
from insonify.cli import explanations
from insonify.cli import reports
from insonify.cli import plans
from insonify.cli import simulation
from insonify.cli import tours
from insonify.cli import datasets
from insonify.cli import exports
from insonify.cli import runs
from insonify.cli import listings
from insonify.cli import configs
from insonify.cli import warming
from insonify.cli import doctoring

# isort: on

__all__ = [
    "app",
    "campaigns",
    "checks",
    "comparisons",
    "configs",
    "datasets",
    "doctoring",
    "explanations",
    "exports",
    "listings",
    "live",
    "main",
    "plans",
    "recordings",
    "reports",
    "runs",
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
    tell(f"insonify: warning: {message}")


def main() -> None:
    """Run the command line; bad input is one sentence and exit code 2."""
    signal.signal(signal.SIGINT, _interrupt)
    for stream in (sys.stdout, sys.stderr):  # a terminal need not have all characters
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    warnings.showwarning = _show_warning
    show_log()
    if len(sys.argv) == 1:
        app()  # shows the help
    try:
        code = app(standalone_mode=False, prog_name="insonify")
        sys.stdout.flush()
        sys.exit(code)
    except _UsageError as err:
        _end(_usage(err))
    except InsonifyError as err:
        _end(str(err))
    except Interrupted:
        _end("interrupted; nothing was written", EXIT_INTERRUPTED)
    except (ReaderGoneError, BrokenPipeError):  # nothing more can be said to it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(EXIT_BROKEN_PIPE)
    except (OSError, MemoryError, UnicodeEncodeError) as err:
        _end(_refused(err))


def _end(message: str, code: int = EXIT_BAD_INPUT) -> NoReturn:
    tell(f"insonify: {message}")
    sys.exit(code)


def _refused(err: OSError | MemoryError | UnicodeEncodeError) -> str:
    """What the machine refuses, in one sentence."""
    if isinstance(err, UnicodeEncodeError):
        return f"the name {err.object!r} is not UTF-8; rename the file"
    if isinstance(err, MemoryError):
        return (
            f"this needs more memory than is free, which is {free_bytes() / 1e9:.3g} GB; give "
            "less, or take a larger machine"
        )
    if err.errno == errno.ENOSPC:
        return "the output cannot be written: no space left"
    told = err.strerror or reason(err)
    about = "" if err.filename is None else f"{os.fsdecode(err.filename)}: "
    return f"{about}{told[:1].lower()}{told[1:]}; check the path, and what may be read and written"


def _version(wanted: bool) -> None:
    if wanted:
        from insonify import __version__

        say(f"insonify {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    pass
