"""Types of messages that are neither standard nor ours, for where no bag brings their definitions.

A driver's own are taken from the ROS 2 workspaces that are sourced (``AMENT_PREFIX_PATH``), where
each package keeps them as ``share/PACKAGE/msg/NAME.msg``: those that the driver was built with.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from insonify.errors import ConfigError, reason
from insonify.io.recordings.ros.bags import DAMAGE
from insonify.io.recordings.ros.definitions import Definitions
from insonify.io.recordings.ros.messages import message_types

PREFIXES = "AMENT_PREFIX_PATH"
_DRIVERS = {
    "ping360_sonar_msgs/msg/SonarEcho": """
std_msgs/Header header
float32 angle
uint8 gain
uint16 number_of_samples
uint16 transmit_frequency
uint16 speed_of_sound
uint8 range
uint8[] intensities
""",
}
"""Known without a workspace.  Later versions have a byte ``step_size`` after the range, where CDR
pads this one, so both are read."""


def fields_of(kind: str) -> set[str] | None:
    """The fields of a type of message, from now on one of `message_types`; None if nobody knows it.

    Args:
        kind: As ``pkg/msg/Name``.

    Raises:
        ConfigError: A workspace has a definition that makes no sense.
    """
    store = message_types()
    if kind not in store.fielddefs:
        found = _defined(kind)
        if found is None:
            return None
        store.register(found)
    return {name for name, _ in store.fielddefs[kind][1]}


def learn(kind: str, known: Typestore) -> bool:
    """Take a type that a bag defines into `message_types`, if it is none of them; whether it is."""
    store = message_types()
    missing: Any = {}
    wanted = [kind]
    while wanted:
        name = wanted.pop()
        if name in store.fielddefs or name in missing:
            continue
        if name not in known.fielddefs:
            return False
        missing[name] = known.fielddefs[name]
        wanted += _inside(known.fielddefs[name])
    if missing:
        store.register(missing)
    return True


def _defined(kind: str) -> Any:
    """The definitions of a type and of those in it that are not known yet; None if one is not."""
    store, definitions = message_types(), Definitions()
    found: Any = {}
    wanted = [kind]
    while wanted:
        name = wanted.pop()
        if name in store.fielddefs or name in found:
            continue
        text, whence = _text(name)
        if text is None:
            return None
        try:
            found |= definitions.types(text, name, "ros2msg")
        except DAMAGE as err:
            raise ConfigError(f"{whence}: is no definition of a message ({reason(err)})") from err
        wanted += _inside(found[name])
    return found


def _text(kind: str) -> tuple[str | None, str]:
    """A definition and where it is from; None if there is none."""
    package, _, name = kind.partition("/msg/")
    for prefix in os.environ.get(PREFIXES, "").split(os.pathsep):
        file = Path(prefix) / "share" / package / "msg" / f"{name}.msg"
        if prefix and name and file.is_file():
            return file.read_text(encoding="utf-8", errors="replace"), str(file)
    return _DRIVERS.get(kind), kind


def _inside(told: Any) -> list[str]:
    """The types that the fields of a type have."""
    names = []
    for _, (node, inside) in told[1]:
        if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            node, inside = inside[0]
        if node is Nodetype.NAME:
            names.append(inside)
    return names
