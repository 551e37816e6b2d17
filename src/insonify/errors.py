"""What can go wrong with a user's input: one base error, caught once at the command line."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class InsonifyError(Exception):
    """Bad input, said in one sentence that names the file or value and what to do about it."""


class ConfigError(InsonifyError):
    """A setting is unknown, of the wrong type or out of its range."""


class MeshError(InsonifyError):
    """A mesh or height raster is missing, unreadable or unusable."""


class WorldError(InsonifyError):
    """A world file is unreadable, or names something that is not there."""


class GeometryError(InsonifyError):
    """A pose, path or area makes no sense: not finite, or through an obstacle."""


class MemoryLimitError(InsonifyError):
    """The map would not fit into the memory that is free."""


class OutputError(InsonifyError):
    """A result cannot be written, or would overwrite something."""


class ResultError(InsonifyError):
    """A result's folder or file is missing, corrupt or of another version."""


class MapFileError(InsonifyError):
    """A map file is missing, corrupt or of another version."""


class RecordingError(InsonifyError):
    """A ping, recording or path file is missing, corrupt or of another version."""


class RendererError(InsonifyError):
    """A renderer cannot be had here, or cannot do what is asked."""


class ClusterError(InsonifyError):
    """A cluster's scheduler does not answer, or its workers cannot fly what is asked."""


class UploadError(InsonifyError):
    """An autopilot does not answer, or does not take what it is given."""


class MissingExtraError(InsonifyError):
    """An optional package is needed and not installed."""


def reason(err: BaseException) -> str:
    """What a library says of damage, cut to a length that fits into a sentence."""
    text = " ".join(str(err).split()) or type(err).__name__
    return text if len(text) <= 160 else f"{text[:157]}..."


@contextmanager
def reading(
    path: Path | str, what: str, error: type[InsonifyError], *damage: type[Exception]
) -> Iterator[None]:
    """What goes wrong while a file is read, as one sentence that names it.

    Args:
        path: The file.
        what: What it should be, as in "a picture".
        error: What is raised; of its own kind, whatever the block raises passes.
        damage: What the library that reads it raises on damage; ``OSError`` and ``MemoryError``
            are always told.

    Raises:
        InsonifyError: It is not there, cannot be read, is damaged, or does not fit into memory.
    """
    try:
        yield
    except InsonifyError:
        raise
    except FileNotFoundError as err:
        noun = what.removeprefix("a ").removeprefix("an ")
        raise error(f"{path}: there is no such {noun}; check the path") from err
    except MemoryError as err:
        raise error(f"{path}: more than the memory that is free is needed to read it") from err
    except OSError as err:
        told = err.strerror.lower() if err.strerror else reason(err)
        raise error(f"{path}: cannot be read as {what} ({told})") from err
    except damage as err:
        raise error(f"{path}: cannot be read as {what} ({reason(err)})") from err
