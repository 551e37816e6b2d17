"""A scene by name or file."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from insonify.config.layers import named_tables
from insonify.config.settings import validated
from insonify.errors import ConfigError
from insonify.scene import Scene
from insonify.scene.experiments import EXPERIMENTS
from insonify.scene.materials import Material
from insonify.scene.placing import FieldSettings, ObjectSettings
from insonify.scene.staged import SeabedSettings, Stage
from insonify.scene.worlds import load_scene


def named_scene(
    world: str, search: Iterable[Path] = (), materials: dict[str, Material] | None = None
) -> Scene:
    """The scene of an experiment, of a scenario, or of a world or mesh file.

    Args:
        world: Its name or path; ``NAME@7`` is a scenario with seed 7, else it is that of seed 0.
        search: Folders in which an SDF world's models are looked for.
        materials: A user's materials by name.

    Raises:
        WorldError: The file cannot be used.
        ConfigError: There is no such name or file.
    """
    if world in EXPERIMENTS:
        return EXPERIMENTS[world]()
    scenarios = named_tables("scenarios")
    name, _, seed = world.partition("@")
    if name in scenarios and (name == world or (seed.isascii() and seed.isdecimal())):
        config = scenarios[name]["config"]
        return Stage(
            validated(ObjectSettings, config.get("object", {}), prefix="object."),
            validated(SeabedSettings, config.get("seabed", {}), prefix="seabed."),
            seed=int(seed or 0),
            field=validated(FieldSettings, config.get("field", {}), prefix="field."),
        ).scene
    path = Path(world)
    if not path.exists():
        names = ", ".join([*EXPERIMENTS, *scenarios, *named_tables("simulations")])
        raise ConfigError(f"{world}: there is no such world or mesh file, nor is it one of {names}")
    return load_scene(path, search=tuple(search), materials=materials)
