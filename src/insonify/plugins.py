"""A user's own planner or mapper, named ``module:Name`` or ``file.py:Name``."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable, Iterable, Mapping
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

from insonify.config.settings import did_you_mean
from insonify.errors import ConfigError

_OF_OBJECTS = ("name", "voxels")
"""What a class need not have before there is an object of it."""


def is_plugin(name: str) -> bool:
    """Whether a name is that of a user's own."""
    return ":" in name


def check_name(
    what: str, name: str, known: Iterable[str], options: Mapping[str, Any] | None
) -> None:
    """Refuse a name that is neither known nor a user's own, before anything is made.

    Raises:
        ConfigError: It is neither, or a known one is given options.
    """
    known = tuple(known)
    if name not in known and not is_plugin(name):
        raise ConfigError(
            f"there is no {what} named {name!r}{did_you_mean(name, known)}, or give your own as "
            "MODULE:NAME or FILE.py:NAME"
        )
    if name in known and options:
        raise ConfigError(f"{what}_options are for a {what} of your own, and {name!r} is not")


def load_plugin(name: str, what: str) -> Callable[..., Any]:
    """What a user's module has under a name; the module's code is run.

    Args:
        name: ``module:Name``, of an installed module or one in this folder, or ``file.py:Name``.
        what: ``planner`` or ``mapper``, for messages.

    Raises:
        ConfigError: There is no such module, file or name.
    """
    where, _, inside = name.rpartition(":")
    module = (
        _from_file(Path(where), name, what)
        if where.endswith(".py")
        else _imported(where, name, what)
    )
    found = getattr(module, inside, None)
    if not callable(found):
        public = [key for key, value in vars(module).items() if isinstance(value, type)]
        own = [key for key in public if vars(module)[key].__module__ == module.__name__]
        raise ConfigError(
            f"{what} {name!r}: {where} has no class {inside!r}{did_you_mean(inside, own or public)}"
        )
    return found  # type: ignore[no-any-return]


def name_of(plugin: Any, known: Iterable[str]) -> str:
    """What an object is recorded as: the name under which its class can be found again."""
    kind = type(plugin)
    if plugin.name in known and kind.__module__.startswith("insonify."):
        return str(plugin.name)
    module = sys.modules.get(kind.__module__)
    file = getattr(module, "__file__", None)
    findable = kind.__module__ != "__main__" and not kind.__module__.startswith("insonify_plugin_")
    where = kind.__module__ if findable or file is None else str(Path(file).absolute())
    return f"{where}:{kind.__qualname__}"


def made(
    factory: Callable[..., Any],
    name: str,
    what: str,
    given: Iterable[Any],
    options: Mapping[str, Any],
    needs: Iterable[str],
) -> Any:
    """A plug-in made, and looked at.

    Args:
        factory: Makes it.
        name: As the user named it.
        what: ``planner`` or ``mapper``.
        given: Arguments by position.
        options: The user's settings, by keyword.
        needs: Attributes that it must have.

    Raises:
        ConfigError: It does not take its arguments, or lacks something.
    """
    if isinstance(factory, type):
        _check_parts(factory, name, what, [key for key in needs if key not in _OF_OBJECTS])
    try:
        plugin = factory(*given, **options)
    except TypeError as err:
        if err.__traceback__ is not None and err.__traceback__.tb_next is not None:
            raise  # not the call, but something in it
        raise ConfigError(f"{what} {name!r}: cannot be made ({err}); see docs/own.md") from err
    check_object(plugin, name, what, needs)
    return plugin


def check_object(plugin: Any, name: str, what: str, needs: Iterable[str]) -> None:
    """Refuse an object that cannot be a planner or mapper.

    Raises:
        ConfigError: It is a class, it lacks something, or its name is no text.
    """
    if isinstance(plugin, type):
        raise ConfigError(f"{what} {name!r}: is a class; give an object of it")
    _check_parts(plugin, name, what, needs)
    if not isinstance(plugin.name, str):
        raise ConfigError(f"{what} {name!r}: its name is no text, but {plugin.name!r}")


def _check_parts(part: Any, name: str, what: str, needs: Iterable[str]) -> None:
    lacking = [key for key in needs if not hasattr(part, key)]
    if lacking:
        raise ConfigError(f"{what} {name!r}: lacks {', '.join(lacking)}; see docs/own.md")


def _from_file(path: Path, name: str, what: str) -> ModuleType:
    """A file's module, once as long as the file stays the same; it may import its neighbours."""
    if not path.is_file():
        raise ConfigError(f"{what} {name!r}: there is no such file as {path}; check the path")
    path = path.resolve()
    stamp = f"{path}:{path.stat().st_mtime_ns}"
    key = f"insonify_plugin_{path.stem}_{hashlib.sha256(stamp.encode()).hexdigest()[:8]}"
    if key in sys.modules:
        return sys.modules[key]
    spec = spec_from_file_location(key, path)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    _look_in(path.parent)
    sys.modules[key] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[key]
        raise
    return module


def _look_in(folder: Path) -> None:
    """Let modules be found in a folder, as Python does for a script's."""
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))


def _imported(where: str, name: str, what: str) -> ModuleType:
    _look_in(Path.cwd())
    try:
        return import_module(where)
    except ModuleNotFoundError as err:
        if err.name is not None and not where.startswith(err.name):
            raise  # what it imports itself
        raise ConfigError(
            f"{what} {name!r}: there is no module {where!r} here or installed; give "
            "MODULE:NAME or FILE.py:NAME"
        ) from err
    except (ValueError, TypeError) as err:
        raise ConfigError(f"{what} {name!r}: no module's name; give MODULE:NAME") from err
