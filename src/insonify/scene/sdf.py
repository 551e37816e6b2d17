"""SDF world and model files as trees: parsing, poses and their frames, includes, search paths."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import unquote
from xml.etree import ElementTree as ET

import numpy as np

from insonify.errors import WorldError
from insonify.frames import rotation_from_rpy
from insonify.limits import FARTHEST_M, MOST_FRAMES
from insonify.scene.xml import parse_xml
from insonify.types import Float64

_PATH_VARIABLES = ("GZ_SIM_RESOURCE_PATH", "GAZEBO_MODEL_PATH", "IGN_GAZEBO_RESOURCE_PATH")
_NEWEST = (1, 12)
_OWN = ("", "__model__", "world", "__root__")
"""Names of a scope's own frame."""


def parse_sdf(path: Path) -> ET.Element:
    """The root of an SDF file.

    Raises:
        WorldError: The file is missing, not XML, not SDF, or of a version not known.
    """
    root = parse_xml(path, WorldError)
    if root.tag != "sdf":
        raise WorldError(f"{path}: not an SDF file, its root is <{root.tag}> and not <sdf>")
    version = root.get("version", "")
    match = re.fullmatch(r"(\d{1,4})\.(\d{1,4})", version.strip())
    if not match or not (1, 0) <= (int(match[1]), int(match[2])) <= _NEWEST:
        raise WorldError(f"{path}: SDF version {version!r:.40} is not known; 1.0 to 1.12 are")
    return root


@dataclass(frozen=True, slots=True)
class SearchPath:
    """Where models and files are looked for.

    Args:
        folders: In order; the folder of each file that names another is looked in too.
    """

    folders: tuple[Path, ...]

    @classmethod
    def around(cls, world: Path, extra: Sequence[Path] = ()) -> SearchPath:
        """The user's folders, those of the environment, and those usual beside a world file."""
        named = [
            Path(part)
            for variable in _PATH_VARIABLES
            for part in os.environ.get(variable, "").split(os.pathsep)
            if part
        ]
        here = world.resolve().parent
        beside = [here, here / "models", here.parent, here.parent / "models"]
        return cls((*extra, *named, *beside))

    def find(self, uri: str, beside: Path) -> Path | None:
        """The file or folder that a URI names, or None.

        ``model://`` and ``package://`` names are looked up in the folders; ``file://`` and plain
        paths are absolute, or beside the file that names them, or in the folders.

        Raises:
            WorldError: A name of a model leaves the folders.
        """
        scheme, mark, rest = uri.partition("://")
        if not mark:
            scheme, rest = "file", uri
        rest = unquote(rest)
        if scheme not in {"model", "package", "file"}:
            return None
        if scheme != "file" and _leaves(rest):
            raise WorldError(
                f"{beside}: {uri!r:.200} leaves the folders in which models are looked for; name "
                "the file by file:// or a path if it is meant"
            )
        roots = list(self.folders)
        if scheme == "file":
            roots = [Path("/"), beside.parent, *roots] if rest.startswith("/") else [
                beside.parent, *roots
            ]  # fmt: skip
        for root in roots:
            found = root / rest.lstrip("/")
            try:
                if found.exists():
                    return found
            except (OSError, ValueError):  # too long for a name, or no name at all
                continue
        return None

    def __str__(self) -> str:
        """The folders, as a message names them."""
        return ", ".join(dict.fromkeys(str(folder) for folder in self.folders)) or "nowhere"


def _leaves(name: str) -> bool:
    """Whether a relative name leads out of the folder it is in."""
    return os.path.normpath(name.lstrip("/")).partition(os.sep)[0] == os.pardir


def model_file(folder: Path) -> Path:
    """The newest SDF file that a model folder's ``model.config`` names.

    Raises:
        WorldError: There is none.
    """
    if folder.is_file():
        return folder
    manifest = folder / "model.config"
    found: list[tuple[tuple[int, ...], Path]] = []
    for entry in parse_xml(manifest, WorldError).iter("sdf") if manifest.is_file() else ():
        version = tuple(int(n) for n in re.findall(r"\d{1,9}", entry.get("version", "0")[:40]))
        name = (entry.text or "").strip()
        if not _leaves(name):
            found.append((version, folder / name))
    if not manifest.is_file():
        found.append(((0,), folder / "model.sdf"))
    for _, path in sorted(found, reverse=True):
        if path.is_file():
            return path
    raise WorldError(f"{folder}: the model has no SDF file; model.config should name one")


def numbers(
    element: ET.Element | None, count: int, default: Sequence[float], where: str
) -> Float64:
    """The numbers in an element's text.

    Raises:
        WorldError: There are more or fewer than ``count``, or they are not finite numbers, or
            beyond `insonify.limits.FARTHEST_M`.
    """
    if element is None or not (element.text or "").strip():
        return np.array(default, np.float64)
    words = (element.text or "").split()
    try:
        values = np.array([float(word) for word in words])
    except ValueError as err:
        raise WorldError(
            f"{where}: <{element.tag}> holds {' '.join(words)!r:.80}, not numbers"
        ) from err
    if len(values) != count or not np.isfinite(values).all():
        raise WorldError(
            f"{where}: <{element.tag}> needs {count} finite numbers, not {' '.join(words)!r:.80}"
        )
    if (np.abs(values) > FARTHEST_M).any():
        raise WorldError(
            f"{where}: <{element.tag}> holds {' '.join(words)!r:.80}; no number may be beyond "
            f"{FARTHEST_M:g}"
        )
    return values


def pose_of(element: ET.Element, where: str) -> tuple[Float64, str]:
    """An element's own pose, (4, 4), and the name of the frame it is given in ("" if unsaid)."""
    pose = element.find("pose")
    values = numbers(pose, 6, [0.0] * 6, where)
    if pose is not None and pose.get("degrees", "false").strip() in {"true", "1"}:
        values[3:] = np.radians(values[3:])
    transform = np.eye(4)
    transform[:3, :3] = rotation_from_rpy(*(math.remainder(a, math.tau) for a in values[3:]))
    transform[:3, 3] = values[:3]
    relative = "" if pose is None else pose.get("relative_to", pose.get("frame", ""))
    return transform, relative.strip()


@dataclass(slots=True)
class Frames:
    """The frames of a world or model, and their poses in its own frame.

    Args:
        where: File and element, for messages.
    """

    where: str
    known: dict[str, tuple[Float64, str]] = field(default_factory=dict)
    _resolved: dict[str, Float64] = field(default_factory=dict)

    def add(self, name: str, pose: Float64, relative_to: str) -> None:
        """A frame with its pose in another ("" is the scope's own)."""
        self.known.setdefault(name, (pose, relative_to))

    def resolve(self, pose: Float64, relative_to: str) -> Float64:
        """A pose given in a frame, in the scope's own frame.

        Raises:
            WorldError: There is no such frame, or frames hang on each other in a circle.
        """
        chain: list[str] = []
        while relative_to not in _OWN and relative_to not in self._resolved:
            if relative_to in chain:
                circle = " -> ".join((*chain[chain.index(relative_to) :][:8], relative_to))
                raise WorldError(f"{self.where}: frames hang on each other in a circle: {circle}")
            if relative_to not in self.known:
                raise WorldError(f"{self.where}: relative_to names no frame: {relative_to!r:.80}")
            chain.append(relative_to)
            if len(chain) > MOST_FRAMES:
                raise WorldError(f"{self.where}: more than {MOST_FRAMES} frames hang on each other")
            relative_to = self.known[relative_to][1]
        above = np.eye(4) if relative_to in _OWN else self._resolved[relative_to]
        for name in reversed(chain):
            above = self._resolved[name] = above @ self.known[name][0]
        return np.asarray(above @ pose, np.float64)


def declared_frames(scope: ET.Element, where: str) -> Iterator[tuple[str, Float64, str]]:
    """The explicit frames, links and joints of a scope; a frame may be attached to another."""
    for element in scope:
        name = element.get("name", "")
        if element.tag == "frame":
            pose, relative = pose_of(element, where)
            yield name, pose, relative or element.get("attached_to", "")
        elif element.tag == "link":
            yield (name, *pose_of(element, where))
        elif element.tag == "joint":
            pose, relative = pose_of(element, where)
            child = (element.findtext("child") or "").strip()
            yield name, pose, relative or child
