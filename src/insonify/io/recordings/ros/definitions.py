"""Definitions of messages in a bag: looked at before rosbags makes code of them.

rosbags unrolls arrays of strings and messages whose length is fixed, and works out the constants of
IDL; a short definition can ask for code without end.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import get_types_from_idl, get_types_from_msg

from insonify.limits import (
    MOST_DEFINITION_BYTES,
    MOST_FIELDS,
    MOST_FIELDS_IN_ALL,
    MOST_UNROLLED,
)

_RULE = "=" * 80 + "\n"
_FIELD = re.compile(r"^[ \t]*[^#\s=][^\n]*$|;", re.MULTILINE)
_SHIFT = re.compile(r"<<\s*(?!\d{1,2}\b)")


@dataclass(slots=True)
class Definitions:
    """What the definitions of a bag have asked for so far."""

    fields: int = 0

    def types(self, text: str, name: str, encoding: str) -> Any:
        """The types that one more definition tells; none if its encoding is not known.

        Raises:
            ValueError: It asks for more than `insonify.limits` allows.
        """
        if len(text) > MOST_DEFINITION_BYTES:
            raise ValueError(f"a message's definition has {len(text):,} characters")
        fields = sum(1 for _ in _FIELD.finditer(text))
        self.fields += fields
        if fields > MOST_FIELDS or self.fields > MOST_FIELDS_IN_ALL:
            raise ValueError(f"a message's definition has {fields:,} fields, all {self.fields:,}")
        if _SHIFT.search(text):
            raise ValueError("a constant in a message's definition is shifted out of all bounds")
        types: Any = {}
        if encoding == "ros2msg":
            types = get_types_from_msg(text, name)
        elif encoding in {"ros2idl", "omgidl"}:
            types = _from_idl(text)
        unrolled = sum(_unrolled(kind) for _, told in types.values() for _, kind in told)
        if unrolled > MOST_UNROLLED:
            raise ValueError(f"a message's definition has arrays of {unrolled:,} things")
        return types


def _unrolled(kind: Any) -> int:
    """For how many things of a field rosbags writes code."""
    node, inside = kind
    if node is not Nodetype.ARRAY:
        return 1
    (inner, of), length = inside
    return 1 if inner is Nodetype.BASE and of[0] != "string" else int(length)


def _from_idl(text: str) -> Any:
    types: Any = {}
    parts = text.split(_RULE)[1:] if text.startswith(f"{_RULE}IDL: ") else [text]
    for part in parts:
        types |= get_types_from_idl(part.split("\n", 1)[1] if part is not text else part)
    return types
