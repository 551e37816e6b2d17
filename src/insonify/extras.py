"""Libraries that only some jobs need, in groups that can be left out."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from types import ModuleType

from insonify.errors import MissingExtraError


def optional(module: str, extra: str, purpose: str) -> ModuleType:
    """Import a module of an extra.

    Raises:
        MissingExtraError: It is not installed.
    """
    try:
        return import_module(module)
    except ImportError as err:
        raise MissingExtraError(
            f"{purpose} needs {module}, which is not installed; "
            f"run: pip install 'insonify[{extra}]'"
        ) from err


@contextmanager
def needed(extra: str, purpose: str) -> Iterator[None]:
    """Around the imports of a module that cannot do without a group of libraries.

    Raises:
        MissingExtraError: One of them is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as err:
        raise MissingExtraError(
            f"{purpose} need {err.name}, which is not installed; run: pip install "
            f"'insonify[{extra}]'"
        ) from err
