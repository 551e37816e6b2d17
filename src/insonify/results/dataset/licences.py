"""What those who are given a dataset may do with it: the user's choice, by name or by text."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from insonify.errors import ConfigError, reason

LICENSE = "LICENSE"
_MOST_BYTES = 1 << 20
_CC = "https://creativecommons.org/licenses"
_KNOWN = {
    "apache-2.0": ("Apache License 2.0", "https://www.apache.org/licenses/LICENSE-2.0"),
    "cc-by-4.0": ("Creative Commons Attribution 4.0 International", f"{_CC}/by/4.0/"),
    "cc-by-nc-4.0": (
        "Creative Commons Attribution-NonCommercial 4.0 International",
        f"{_CC}/by-nc/4.0/",
    ),
    "cc-by-sa-4.0": (
        "Creative Commons Attribution-ShareAlike 4.0 International",
        f"{_CC}/by-sa/4.0/",
    ),
    "cc0-1.0": (
        "Creative Commons Zero 1.0 Universal",
        "https://creativecommons.org/publicdomain/zero/1.0/",
    ),
    "mit": ("MIT License", "https://opensource.org/license/mit"),
    "odc-by": ("Open Data Commons Attribution", "https://opendatacommons.org/licenses/by/1-0/"),
}
"""Names that the Hugging Face hub knows, with titles and links."""


@dataclass(frozen=True, slots=True)
class Licence:
    """What a dataset is given away under.

    Attributes:
        key: A name that the Hugging Face hub knows, ``other`` for a text of one's own.
        name: For people.
        link: Where it is written; a file of the dataset for a text of one's own.
        text: That text, else empty.
    """

    key: str
    name: str
    link: str
    text: str = ""


def licence_of(chosen: str) -> Licence | None:
    """The licence that a name or a text file means; None if none is chosen.

    Raises:
        ConfigError: It is neither, or the file cannot be read.
    """
    if not chosen:
        return None
    if chosen.lower() in _KNOWN:
        return Licence(chosen.lower(), *_KNOWN[chosen.lower()])
    path = Path(chosen)
    if not path.is_file():
        raise ConfigError(
            f"license: {chosen!r} is no text file, nor one of {', '.join(_KNOWN)}; give a "
            "file with the text of any other"
        )
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise ConfigError(f"{path}: is longer than 1 MB; give the text of a licence")
        return Licence("other", path.stem, LICENSE, path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as err:
        raise ConfigError(
            f"{path}: cannot be read as the text of a licence ({reason(err)})"
        ) from err
