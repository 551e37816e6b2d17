"""XML files of worlds and meshes: read whole, without entities, and no deeper than makes sense."""

from __future__ import annotations

import xml.parsers.expat as expat
from pathlib import Path
from xml.etree import ElementTree as ET

from insonify.errors import InsonifyError, reading
from insonify.limits import MOST_XML_BYTES, MOST_XML_DEPTH, MOST_XML_ELEMENTS


def parse_xml(path: Path, error: type[InsonifyError]) -> ET.Element:
    """The root of an XML file; tags keep their prefix as it is written.

    Raises:
        InsonifyError: The file is missing, not XML, declares entities, or is larger or nested
            deeper than `insonify.limits` allows.
    """
    builder = _Builder(path, error)
    parser = expat.ParserCreate()  # without namespaces: `insonify:reflectance` needs no xmlns
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.tree.data
    parser.EntityDeclHandler = builder.entity
    damage = (expat.ExpatError, AssertionError, ValueError, LookupError, TypeError)
    with reading(path, "XML", error, *damage):
        if path.stat().st_size > MOST_XML_BYTES:
            raise error(f"{path}: more than {MOST_XML_BYTES >> 20} MiB of XML; give a smaller one")
        parser.Parse(path.read_bytes(), True)
        return builder.tree.close()


class _Builder:
    """What the parser tells, as a tree."""

    def __init__(self, path: Path, error: type[InsonifyError]) -> None:
        self.tree = ET.TreeBuilder()
        self._path, self._error = path, error
        self._depth = self._count = 0

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        self._depth, self._count = self._depth + 1, self._count + 1
        if self._depth > MOST_XML_DEPTH:
            raise self._error(f"{self._path}: elements are nested more than {MOST_XML_DEPTH} deep")
        if self._count > MOST_XML_ELEMENTS:
            raise self._error(f"{self._path}: it has more than {MOST_XML_ELEMENTS:,} elements")
        self.tree.start(tag, attributes)

    def end(self, tag: str) -> None:
        self._depth -= 1
        self.tree.end(tag)

    def entity(self, name: str, *more: object) -> None:
        raise self._error(f"{self._path}: it declares the entity {name!r}; entities are not read")
