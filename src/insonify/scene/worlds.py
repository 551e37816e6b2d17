"""Scenes from SDF worlds and models, and from meshes (Cerqueira et al. 2017, section 3.1)."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import trimesh

from insonify import limits, memory
from insonify.errors import WorldError
from insonify.pictures import opened_picture
from insonify.scene import Body, Scene
from insonify.scene.materials import Material, NormalMap, material_named, read_normal_map
from insonify.scene.meshes import MESH_SUFFIXES, load_mesh
from insonify.scene.sdf import (
    Frames,
    SearchPath,
    declared_frames,
    model_file,
    numbers,
    parse_sdf,
    pose_of,
)
from insonify.scene.seabed import grid_triangles
from insonify.scene.shapes import SHAPES
from insonify.types import Float64

_LIGHTS = {"sun", "sunlight", "light", "lights", "sky"}
"""Models that hold a light alone, by the names that worlds include them by."""


BYTES_PER_TRIANGLE = 200
"""With its share of vertices and of the tree that rays go down."""


class WorldWarning(UserWarning):
    """A part of a world that is left out; the scene is usable without it."""


def load_scene(
    path: Path,
    *,
    search: Sequence[Path] = (),
    collisions: bool = False,
    materials: Mapping[str, Material] | None = None,
) -> Scene:
    """A scene from an SDF world or model, a model's folder, or a mesh file.

    Visuals become bodies, each labelled with its top-level model's name; visuals of water are no
    targets and are left out.  A material comes from the visual's ``<insonify:reflectance>`` (and
    ``<insonify:lambert_db>``), or by the name of its material script, its visual or its model,
    first from ``materials`` and then from the named ones; normal maps from its PBR material.

    Args:
        path: The file.
        search: Folders in which models are looked for first; then those of
            GZ_SIM_RESOURCE_PATH and GAZEBO_MODEL_PATH, and those beside the world.
        collisions: Collision geometry instead of visuals.
        materials: A user's own, by name.

    Raises:
        WorldError: The world cannot be read, or names a model, mesh or frame that is not there.
        MeshError: A mesh is damaged.

    Warns:
        WorldWarning: A part is left out, a texture on the web, say.
    """
    if path.suffix.lower() in MESH_SUFFIXES:
        material = material_named(path.stem, materials) or Material("default")
        return Scene((Body(path.stem, load_mesh(path), material),))
    if path.is_dir():
        path = model_file(path)
    reader = _Reader(SearchPath.around(path, search), collisions, materials or {}, _Tally(path))
    bodies = reader.read(path, np.eye(4), "", ())
    if not bodies:
        kind = "collision" if collisions else "visual"
        raise WorldError(f"{path}: there is no {kind} geometry in it that echoes")
    return Scene(tuple(bodies))


@dataclass(slots=True)
class _Tally:
    """What a world has asked for so far."""

    world: Path
    includes: int = 0
    bodies: int = 0
    triangles: int = 0
    pixels: int = 0

    def add(self, includes: int = 0, bodies: int = 0, triangles: int = 0, pixels: int = 0) -> None:
        """Count more.

        Raises:
            WorldError: It is more than `insonify.limits` allows, or than fits into memory.
        """
        self.includes += includes
        self.bodies += bodies
        self.triangles += triangles
        self.pixels += pixels
        for name, count, most in (
            ("models to include", self.includes, limits.MOST_INCLUDES),
            ("shapes", self.bodies, limits.MOST_BODIES),
            ("triangles", self.triangles, limits.MOST_TRIANGLES),
            ("pixels of normal maps", self.pixels, limits.MOST_WORLD_PIXELS),
        ):
            if count > most:
                raise WorldError(
                    f"{self.world}: it asks for more than {most:,} {name}; give a smaller world"
                )
        needed = self.triangles * BYTES_PER_TRIANGLE + 12 * self.pixels
        if not memory.fits(needed):
            raise WorldError(f"{self.world}: its shapes would need {memory.shortage(needed)}")


@dataclass(frozen=True, slots=True)
class _Reader:
    """Turns SDF elements into bodies."""

    search: SearchPath
    collisions: bool
    materials: Mapping[str, Material]
    tally: _Tally

    def read(
        self, path: Path, world_from_file: Float64, label: str, trail: tuple[Path, ...],
        override: tuple[Float64, str] | None = None, frames: Frames | None = None,
    ) -> list[Body]:  # fmt: skip
        """The bodies of a file; ``override`` is the pose that an include puts on its model."""
        path = path.resolve()
        if path in trail:
            circle = " -> ".join(p.parent.name + "/" + p.name for p in (*trail[:8], path))
            raise WorldError(f"{path}: models include each other in a circle: {circle}")
        if len(trail) > limits.MOST_INCLUDE_DEPTH:
            raise WorldError(
                f"{trail[0]}: models include each other more than {limits.MOST_INCLUDE_DEPTH} deep"
            )
        root = parse_sdf(path)
        trail = (*trail, path)
        bodies = []
        for element in root:
            if element.tag == "world":
                bodies += self._scope(element, path, world_from_file, "", trail)
            elif element.tag == "model":
                if override is not None and frames is not None:
                    placed = world_from_file @ frames.resolve(*override)
                else:
                    placed = world_from_file @ pose_of(element, str(path))[0]
                bodies += self._scope(
                    element, path, placed, label or element.get("name", path.stem), trail
                )
        return bodies

    def _scope(
        self, scope: ET.Element, path: Path, world_from_scope: Float64, label: str,
        trail: tuple[Path, ...],
    ) -> list[Body]:  # fmt: skip
        """The bodies of a world or model."""
        where = f"{path} ({scope.tag} {scope.get('name', '')!r})"
        frames = Frames(where)
        for name, pose, relative in declared_frames(scope, where):
            frames.add(name, pose, relative)
        for element in scope:
            if element.tag in {"model", "include"}:
                frames.add(_name_of(element), *pose_of(element, where))
        bodies: list[Body] = []
        for element in scope:
            if element.tag == "model":
                placed = world_from_scope @ frames.resolve(*pose_of(element, where))
                name = label or element.get("name", "model")
                bodies += self._scope(element, path, placed, name, trail)
            elif element.tag == "include":
                bodies += self._include(element, path, world_from_scope, label, trail, frames)
            elif element.tag == "link":
                placed = world_from_scope @ frames.resolve(*pose_of(element, where))
                bodies += self._link(element, path, placed, label or "world", frames)
        return bodies

    def _include(
        self, include: ET.Element, path: Path, world_from_scope: Float64, label: str,
        trail: tuple[Path, ...], frames: Frames,
    ) -> list[Body]:  # fmt: skip
        self.tally.add(includes=1)
        uri = (include.findtext("uri") or "").strip()
        found = self.search.find(uri, path)
        if found is None and _is_spared(uri):
            warnings.warn(
                f"{path}: the included model {uri!r} is not there, and is left out",
                WorldWarning,
                stacklevel=2,
            )
            return []
        if found is None:
            raise WorldError(
                f"{path}: the included model {uri or '(no uri)'!r:.200} is not there; looked in "
                f"{self.search} (--search DIR or GZ_SIM_RESOURCE_PATH adds a folder)"
            )
        override = pose_of(include, str(path)) if include.find("pose") is not None else None
        label = label or _name_of(include)
        return self.read(model_file(found), world_from_scope, label, trail, override, frames)

    def _link(
        self, link: ET.Element, path: Path, world_from_link: Float64, label: str, frames: Frames
    ) -> list[Body]:
        bodies = []
        for shape in link.iter("collision" if self.collisions else "visual"):
            where = f"{path} ({label}, {shape.tag} {shape.get('name', '')!r})"
            pose, relative = pose_of(shape, where)
            if relative and relative != link.get("name"):
                in_scope = frames.resolve(*frames.known[link.get("name", "")])
                pose = np.linalg.inv(in_scope) @ frames.resolve(pose, relative)
            if not self.collisions and _is_water(shape):
                continue
            self.tally.add(bodies=1)
            mesh = self._geometry(shape, path, where)
            if mesh is None:
                continue
            self.tally.add(triangles=len(mesh.faces))
            mesh.apply_transform(world_from_link @ pose)
            material = self._material(shape, label, where)
            bodies.append(Body(label, mesh, material, self._normal_map(shape, mesh, path, where)))
        return bodies

    def _geometry(self, shape: ET.Element, path: Path, where: str) -> trimesh.Trimesh | None:
        geometry = shape.find("geometry")
        kinds = [] if geometry is None else list(geometry)
        for element in kinds:
            if element.tag == "mesh":
                return self._mesh(element, path, where)
            if element.tag == "heightmap":
                return self._heightmap(element, path, where)
            if element.tag in SHAPES:
                return SHAPES[element.tag](element, where)
        names = ", ".join(e.tag for e in kinds if e.tag != "empty")
        if names:
            warnings.warn(
                f"{where}: geometry <{names}> is not known and is left out",
                WorldWarning,
                stacklevel=2,
            )
        return None

    def _mesh(self, element: ET.Element, path: Path, where: str) -> trimesh.Trimesh:
        uri = (element.findtext("uri") or "").strip()
        found = self.search.find(uri, path)
        if found is None or not found.is_file():
            raise WorldError(
                f"{where}: the mesh {uri or '(no uri)'!r:.200} is not there; looked in "
                f"{self.search}"
            )
        scale = numbers(element.find("scale"), 3, [1.0, 1.0, 1.0], where)
        if not scale.all():
            raise WorldError(f"{where}: <scale> {' '.join(f'{s:g}' for s in scale)} has a 0 in it")
        submesh = element.find("submesh")
        part = "" if submesh is None else (submesh.findtext("name") or "").strip()
        mesh = load_mesh(found, part=part)
        if submesh is not None and (submesh.findtext("center") or "").strip() in {"true", "1"}:
            mesh.apply_translation(-mesh.bounds.mean(axis=0))
        mesh.apply_transform(np.diag([*scale, 1.0]))
        return mesh

    def _heightmap(self, element: ET.Element, path: Path, where: str) -> trimesh.Trimesh:
        if element.find("size") is None:
            raise WorldError(f"{where}: the heightmap has no <size>; give its x, y and z in metres")
        size = numbers(element.find("size"), 3, [], where)
        at = numbers(element.find("pos"), 3, [0.0] * 3, where)
        uri = (element.findtext("uri") or "").strip()
        found = self.search.find(uri, path)
        if found is None:
            raise WorldError(f"{where}: the heightmap {uri!r:.200} is not there")
        with opened_picture(found, "a heightmap", WorldError, limits.MOST_HEIGHTS) as picture:
            self.tally.add(triangles=2 * picture.width * picture.height)
            grey = np.asarray(picture.convert("F" if picture.mode[0] in "IF" else "L"), float)
        rows, columns = grey.shape
        if min(rows, columns) < 2 or not (size > 0).all() or not np.isfinite(grey).all():
            raise WorldError(f"{where}: the heightmap {found.name} of {size} m is no surface")
        top = max(float(grey.max()), 255.0 if grey.max() <= 255.0 else 65535.0)
        x = np.linspace(-0.5, 0.5, columns) * size[0] + at[0]
        y = np.linspace(-0.5, 0.5, rows) * size[1] + at[1]
        vertices, faces = grid_triangles(x, y, grey[::-1] / top * size[2] + at[2])
        return trimesh.Trimesh(vertices, faces, process=False)

    def _material(self, shape: ET.Element, label: str, where: str) -> Material:
        material = shape.find("material")
        own = {
            element.tag.removeprefix("insonify:"): float(numbers(element, 1, [np.nan], where)[0])
            for element in shape.iter()
            if element.tag in {"insonify:reflectance", "insonify:lambert_db"}
        }
        if own:
            return Material(shape.get("name", label), **own)
        names = [] if material is None else [e.text or "" for e in material.iter("name")]
        for name in (*names, shape.get("name", ""), label):
            found = material_named(name, self.materials)
            if found is not None:
                return found
        return Material("default")

    def _normal_map(
        self, shape: ET.Element, mesh: trimesh.Trimesh, path: Path, where: str
    ) -> NormalMap | None:
        uri = (shape.findtext("material/pbr/metal/normal_map") or "").strip()
        if not uri:
            return None
        found = self.search.find(uri, path)
        uv = getattr(mesh.visual, "uv", None)
        if found is None or uv is None:
            why = "is not there" if found is None else "has a mesh without texture coordinates"
            warnings.warn(
                f"{where}: the normal map {uri} {why} and is left out", WorldWarning, stacklevel=2
            )
            return None
        normals = read_normal_map(found)
        self.tally.add(pixels=normals.shape[0] * normals.shape[1])
        return NormalMap(normals, np.asarray(uv, np.float64))


def _is_spared(uri: str) -> bool:
    """Whether a world can do without an include: lights, and what lies on the web."""
    name = uri.rstrip("/").rsplit("/", 1)[-1].lower()
    return uri.startswith(("http://", "https://")) or name in _LIGHTS


def _name_of(element: ET.Element) -> str:
    """The name of a model, or of an include: its own, or its model's folder's."""
    own = element.get("name") or (element.findtext("name") or "").strip()
    return own or (element.findtext("uri") or "").strip().rstrip("/").split("/")[-1]


def _is_water(shape: ET.Element) -> bool:
    """Whether a visual shows water: its own name or its material's says so."""
    texts = [shape.get("name", "")]
    material = shape.find("material")
    if material is not None:
        texts += [e.text or "" for tag in ("uri", "name") for e in material.iter(tag)]
    words = " ".join(texts).lower()
    return "water" in words.replace("underwater", "") or "ocean_surface" in words
