"""The true world of a simulated scan, as one NumPy archive: what maps of it are held against."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from insonify.errors import RecordingError
from insonify.evaluation import GroundTruth, Solid
from insonify.io.archives import read_archive
from insonify.scene import Scene
from insonify.scene.seabed import Seabed
from insonify.types import Array, Box

FORMAT, VERSION = "insonify-truth", 1
_VOXELS = ("surface", "solid", "scored")


def save_truth(path: Path, truth: GroundTruth, scene: Scene) -> None:
    """Write ground-truth voxels and the world.

    Arrays: ``format``, ``version``; ``low_m``, ``high_m`` (3,) and ``shape`` (3,) of the voxels'
    box; ``surface``, ``solid`` and ``scored``, one bit a voxel, x outermost; ``names`` of the
    bodies, and of body K ``K_vertices`` (N, 3) float32 metres and ``K_faces`` (M, 3) int32; of a
    seabed ``seabed_heights_m`` (rows, columns) float32, ``seabed_cell_m`` and ``seabed_origin_m``
    (2,) of its first cell.
    """
    arrays: dict[str, Array] = {
        "low_m": np.array(truth.box.low_m),
        "high_m": np.array(truth.box.high_m),
        "shape": np.array(truth.solid.shape),
        "names": np.array([body.name for body in scene.bodies], str),
    }
    arrays |= {name: np.packbits(getattr(truth, name)) for name in _VOXELS}
    for number, body in enumerate(scene.bodies):
        arrays[f"{number}_vertices"] = np.asarray(body.mesh.vertices, np.float32)
        arrays[f"{number}_faces"] = np.asarray(body.mesh.faces, np.int32)
    if scene.seabed is not None:
        arrays["seabed_heights_m"] = scene.seabed.heights_m.astype(np.float32)
        arrays["seabed_cell_m"] = np.array(scene.seabed.cell_m)
        arrays["seabed_origin_m"] = np.array(scene.seabed.origin_m)
    with path.open("wb") as file:  # not compressed, which would take long and save little
        np.savez(
            file, format=np.array(FORMAT), version=np.array(VERSION), allow_pickle=False, **arrays
        )


def load_truth(path: Path) -> tuple[GroundTruth, tuple[Solid, ...]]:
    """Read what `save_truth` wrote.

    Raises:
        RecordingError: The file is missing, is no such file, or is damaged.
    """
    arrays = read_archive(path, FORMAT, VERSION, RecordingError)
    try:
        nx, ny, nz = (int(n) for n in arrays["shape"])
        shape = (nx, ny, nz)
        count = int(np.prod(shape))
        surface, solid, scored = (
            np.unpackbits(arrays[name])[:count].astype(bool).reshape(shape) for name in _VOXELS
        )
        box = Box.of(arrays["low_m"].tolist(), arrays["high_m"].tolist())
        solids = [
            _solid(str(name), arrays[f"{number}_vertices"], arrays[f"{number}_faces"])
            for number, name in enumerate(arrays["names"])
        ]
        if "seabed_heights_m" in arrays:
            x_m, y_m = arrays["seabed_origin_m"].tolist()
            heights_m = arrays["seabed_heights_m"].astype(np.float64)
            seabed = Seabed(heights_m, float(arrays["seabed_cell_m"]), (x_m, y_m))
            solids.append(Solid("seabed", *seabed.triangles()))
        if not np.isfinite([*box.low_m, *box.high_m]).all():
            raise ValueError("its box is not finite")
    except (KeyError, ValueError, TypeError) as err:
        raise RecordingError(f"{path}: damaged, it lacks or garbles an array ({err})") from err
    return GroundTruth(box, surface, solid, scored), tuple(solids)


def _solid(name: str, vertices: Array, faces: Array) -> Solid:
    if vertices.ndim != 2 or vertices.shape[1] != 3 or not np.isfinite(vertices).all():
        raise ValueError(f"{name} has no vertices")
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind != "i":
        raise ValueError(f"{name} has no faces")
    if len(faces) and not 0 <= faces.min() <= faces.max() < len(vertices):
        raise ValueError(f"{name} has faces without vertices")
    return Solid(name, vertices, faces)
