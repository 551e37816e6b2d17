"""Libraries that only some formats need."""

from __future__ import annotations

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
