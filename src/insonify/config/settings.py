"""The base of every table of settings, and what is said of one that is wrong."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable
from typing import Any, Self, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

from insonify.errors import ConfigError
from insonify.limits import MOST_SETTING

Table = dict[str, Any]


class Settings(BaseModel):
    """A table of settings: frozen, and unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)  # starts sooner

    @model_validator(mode="after")
    def _sensible(self) -> Self:
        """Numbers so large that computing with them says nothing are no settings."""
        for name in type(self).model_fields:
            value = getattr(self, name)
            for number in value if isinstance(value, tuple) else (value,):
                if isinstance(number, float) and MOST_SETTING < abs(number) < math.inf:
                    raise ValueError(
                        f"{name} must not be beyond {MOST_SETTING:g}, as is {number:g}"
                    )
        return self


Model = TypeVar("Model", bound=BaseModel)


def validated(
    model: type[Model],
    table: Table,
    *,
    prefix: str = "",
    where: str = "",
    see: str = "`insonify config tetrapod` for all settings",
) -> Model:
    """A table as a model's settings.

    Args:
        model: What they are of.
        table: The settings.
        prefix: The table's own key, with a dot.
        where: The file that they stand in, if that is one of their own.
        see: Where they are described.

    Raises:
        ConfigError: A setting is unknown, of the wrong type or out of its range.
    """
    try:
        return model.model_validate(table)
    except ValidationError as err:
        whose = f"{where}: " if where else ""
        raise ConfigError(f"{whose}{_explain(err, model, prefix, see)}") from err


def _explain(err: ValidationError, model: type[BaseModel], prefix: str, see: str) -> str:
    """One of pydantic's complaints as a sentence: the first, or the wrong name behind it."""
    told = err.errors()
    first, lacking = told[0], _key(told[0])
    if first["type"] == "missing":  # a misspelt name is likely what was meant for it
        unknown = [one for one in told if one["type"] == "extra_forbidden"]
        like = (one for one in unknown if difflib.get_close_matches(_key(one), [lacking]))
        first = next(like, first)
    key = prefix + _key(first)
    if first["type"] == "extra_forbidden":
        return f"there is no setting {key!r}{did_you_mean(key, all_keys(model, prefix), see)}"
    message = first["msg"].removeprefix("Value error, ")
    message = message[:1].lower() + message[1:]
    given = first.get("input")
    value = f", not {given!r}" if not isinstance(given, dict | list) else ""
    name = f"setting {key}: " if key else ""
    return f"{name}{message}{value}; see {see}"


def _key(complaint: Any) -> str:
    return ".".join(str(part) for part in complaint["loc"])


def all_keys(model: type[BaseModel], prefix: str = "") -> list[str]:
    """The dotted names of a model's settings."""
    keys = []
    for name, field in model.model_fields.items():
        inner = field.annotation
        if isinstance(inner, type) and issubclass(inner, BaseModel):
            keys += all_keys(inner, f"{prefix}{name}.")
        else:
            keys.append(prefix + name)
    return keys


def did_you_mean(word: str, known: Iterable[str], see: str = "the docs") -> str:
    """The end of a message about an unknown name: the nearest known one, or all if they are few.

    One of the same last part, in another table or in none, is the nearest.
    """
    names = sorted(known)
    same = [name for name in names if name.split(".")[-1] == word.split(".")[-1]]
    close = difflib.get_close_matches(word, same, n=1, cutoff=0.0) or difflib.get_close_matches(
        word, names, n=1
    )
    if close:
        return f"; did you mean {close[0]!r}?"
    return f"; choose one of {', '.join(names)}" if len(names) < 12 else f"; see {see}"
