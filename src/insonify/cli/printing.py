"""The one place that prints: names that came from files are text, neither markup nor commands."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

from insonify.names import plain

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

MOST_CHARACTERS = 1000
"""Of a message: of a longer one the middle is left out."""


_LEAST_WIDE = 24
"""Characters that the last column of a table needs, if it has as many."""


class ReaderGoneError(Exception):
    """Who reads what is printed has gone; it is not the system's error, which typer would take."""


_before: list[Callable[[], None]] = []


def before_output(ended: Callable[[], None]) -> None:
    """Call something once, before the next that is said."""
    _before.append(ended)


def _clear() -> None:
    while _before:
        _before.pop()()


def _out(text: str, *, flush: bool = False) -> None:
    _clear()
    try:
        print(text, flush=flush)
    except BrokenPipeError as err:
        raise ReaderGoneError from err


def say(text: str, *, flush: bool = False) -> None:
    """A result of one line, on stdout."""
    _out(plain(text), flush=flush)


def say_lines(text: str) -> None:
    """A document of ours, on stdout."""
    for line in text.split("\n"):
        _out(plain(line))


def say_json(told: Any, *, indent: int | None = 2, flush: bool = False) -> None:
    """One JSON document, on stdout; JSON escapes control characters itself."""
    _out(json.dumps(told, indent=indent, default=str), flush=flush)


def tell(text: str, *, flush: bool = False) -> None:
    """A message, on stderr."""
    _clear()
    line = plain(text)
    if len(line) > MOST_CHARACTERS:
        line = f"{line[: MOST_CHARACTERS - 300]} ... {line[-250:]}"
    print(line, file=sys.stderr, flush=flush)


def console(*, stderr: bool = False) -> Console:
    """What draws tables and bars; no string given to it is markup."""
    from rich.console import Console
    from rich.text import Text

    class _Plain(Console):
        def render_str(self, text: str, **more: Any) -> Text:
            return super().render_str(plain(text), **(more | {"markup": False, "emoji": False}))

        def on_broken_pipe(self) -> None:
            raise ReaderGoneError

    return _Plain(stderr=stderr)


def say_listing(head: list[str], rows: Iterable[list[str]]) -> None:
    """A table of text, on stdout; where that is too narrow for it, a cell a line."""
    from rich.table import Table

    rows = [[plain(cell) for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(head, *rows, strict=True)]
    left = console().width - sum(widths[:-1]) - 3 * len(widths) - 1
    if len(head) > 2 and left < min(widths[-1], _LEAST_WIDE):
        for row in rows:
            say(row[0])
            for title, cell in zip(head[1:], row[1:], strict=True):
                say(f"  {title}: {cell}")
        return
    table = Table()
    for number, title in enumerate(head):
        last = number == len(head) - 1
        table.add_column(title, no_wrap=not last, overflow="fold")
    for row in rows:
        table.add_row(*row)
    say_table(table)


def say_table(table: Table) -> None:
    """A table of rich, on stdout."""
    _clear()
    console().print(table)
