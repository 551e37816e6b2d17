"""Pictures of other programs: opened once for all readers, and not unpacked if they are huge."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from PIL import Image

from insonify.errors import InsonifyError, reading
from insonify.limits import MOST_PIXELS


@contextmanager
def opened_picture(
    path: Path, what: str, error: type[InsonifyError], most_pixels: int = MOST_PIXELS
) -> Iterator[Image.Image]:
    """A picture whose size has been looked at, and whose pixels have not yet been read.

    Args:
        path: The file.
        what: What it is for, as in "a normal map", for messages.
        error: What is raised.
        most_pixels: It may have.

    Raises:
        InsonifyError: It is missing, damaged or larger; also whatever goes wrong in the block.
    """
    with reading(path, what, error, Exception), warnings.catch_warnings():
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # ours is the limit
        with Image.open(path) as picture:
            width, height = picture.size
            if width * height > most_pixels:
                raise error(
                    f"{path}: {width} x {height} pixels are more than the {most_pixels:,} that "
                    f"{what} may have; give a smaller one"
                )
            yield picture
