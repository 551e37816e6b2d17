"""Libraries that only some jobs need, in groups that can be left out."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from types import ModuleType

from insonify.errors import MissingExtraError


def optional(module: str, extra: str, purpose: str) -> ModuleType:
    """Import a module of a group.

    Args:
        module: Its name.
        extra: The group.
        purpose: What needs it, for the message.

    Raises:
        MissingExtraError: It is not installed.
    """
    try:
        return import_module(module)
    except ImportError as err:
        raise _missing(module.partition(".")[0], extra, f"{purpose} needs") from err


def require(extra: str, purpose: str, *modules: str) -> None:
    """Refuse to go on without a group; a room that is made of it calls this first.

    Args:
        extra: The group.
        purpose: What needs it, in the plural, for the message.
        modules: What must be installed; nothing is imported.

    Raises:
        MissingExtraError: One of them is not installed.
    """
    for module in modules:
        if find_spec(module) is None:
            raise _missing(module, extra, f"{purpose} need")


def _missing(module: str, extra: str, what_needs: str) -> MissingExtraError:
    return MissingExtraError(
        f"{what_needs} {module}, which is not installed; run: pip install 'insonify[{extra}]'"
    )
