"""Text that came from a file or a command line, where it is shown, and where it names a file."""

from __future__ import annotations

LONGEST_FILE_NAME_BYTES = 100
"""Of 255 that file systems have; numbers, suffixes and scratch names are put around it."""
_FORMULA = ("=", "+", "-", "@")


def plain(text: str) -> str:
    """Text on one line without control characters, which terminals would obey.

    What cannot be printed is ``?``: escapes, marks that turn the direction of writing, halves of
    characters of names that are not UTF-8.
    """
    if text.isascii() and text.isprintable():
        return text
    return "".join(char if char.isprintable() else " " if char.isspace() else "?" for char in text)


def file_name(text: str) -> str:
    """A name for a file or folder in the folder meant, made of any text.

    Letters and digits of any script, ``.``, ``-``, ``_`` and ``+`` stay, the rest is ``-``.  It
    begins with none of the marks, so that it is neither hidden nor an option.
    """
    kept = "".join(char if char.isalnum() or char in "._-+" else "-" for char in text)
    short = kept.lstrip("._-+").encode("utf-8", "ignore")[:LONGEST_FILE_NAME_BYTES]
    return short.decode("utf-8", "ignore").rstrip(".") or "unnamed"


def figure_text(text: str) -> str:
    """Text in a picture: matplotlib would read what is between two ``$`` as a formula."""
    return plain(text).replace("$", r"\$")


def csv_cell(value: object) -> object:
    """A cell of a table; text that a spreadsheet would take for a formula gets a quote before."""
    if isinstance(value, str) and value.lstrip().startswith(_FORMULA):
        return f"'{value}"
    return value
