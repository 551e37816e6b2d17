"""Campaigns: mappers x planners x scenarios x sonars x image models x navigation x seeds.

A campaign is a list of chains.  The runs of a chain differ in their planner alone; each run is a
pure function of its config, and is known by its hash.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain, product
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from insonify import __version__
from insonify.config.layers import absolute, named_files, overlaid, read_table, settled
from insonify.config.settings import Settings, Table, did_you_mean, validated
from insonify.errors import ConfigError
from insonify.mission.setup import Config, scenario_config
from insonify.planning.factory import FIXED_PLANS
from insonify.plugins import is_plugin, load_plugin
from insonify.vehicle.description import vehicle_named
from insonify.vehicle.instruments import PoseNoiseSettings
from insonify.vehicle.settings import TELEPORT

FIRST = "entropy"
"""Flies first; the planners with a fixed plan then get as many scans as it took."""
FACTORS = ("scenario", "sonar", "model", "navigation", "mapper", "planner", "seed")
"""What a campaign varies, from the slowest to the fastest."""
SEE = "docs/campaigns.md"
_SCHEMA = 1
_LISTS = {
    "scenarios": "scenario",
    "sonars": "sonar",
    "models": "model",
    "navigation": "navigation",
    "mappers": "mapper",
    "planners": "planner",
}
"""The lists of a campaign, and what each is a list of."""


def _counted(told: Any) -> Any:
    """So many seeds, from 0."""
    if isinstance(told, int) and not isinstance(told, bool):
        told = tuple(range(told))
    if not isinstance(told, tuple | list) or not told:
        raise ValueError("should be how many seeds, at least one, or a list of them")
    return told


class CampaignSettings(Settings):
    """What to fly.  A list that is empty leaves the choice to the settings."""

    title: str = ""
    seeds: Annotated[
        tuple[Annotated[int, Field(ge=0, lt=2**63)], ...], BeforeValidator(_counted)
    ] = Field(tuple(range(5)), description="a list, or how many, from 0")
    scenarios: tuple[str, ...] = Field(min_length=1, description="see: insonify scenarios")
    planners: tuple[str, ...] = Field((), description="by name, or your own: module:Name")
    mappers: tuple[str, ...] = Field((), description="by name, or your own: module:Name")
    navigation: tuple[Literal["none", "noise", "truth", "dvl"], ...] = Field(
        (),
        description="none, noise: no vehicle, and poses that are off by vehicle.pose_noise; "
        "truth, dvl: of the vehicle that the settings name",
    )
    sonars: tuple[str, ...] = Field((), description="see: insonify sonars")
    models: tuple[str, ...] = Field((), description="cerqueira, physical")
    same_scans: bool = Field(
        True, description="uniform and lawnmower fly as many scans as entropy; else as set"
    )
    set: Table = Field({}, description="settings of all runs")
    set_for: dict[str, Table] = Field({}, description="settings of the runs with this in them")


@dataclass(frozen=True, slots=True)
class Chain:
    """Runs that differ in their planner alone.

    Attributes:
        runs: Their configs, in the order of the tables.
        same_scans: Whether `FIRST` says how many scans fixed plans fly.
    """

    runs: tuple[Config, ...]
    same_scans: bool = True

    @property
    def first(self) -> int | None:
        """Which of them says how many scans others fly, if one does."""
        names = [run.planner for run in self.runs]
        return names.index(FIRST) if self.same_scans and FIRST in names else None

    @property
    def following(self) -> tuple[int, ...]:
        """Those that wait for `first`."""
        if self.first is None:
            return ()
        return tuple(k for k, run in enumerate(self.runs) if run.planner in FIXED_PLANS)


def read_campaign(path: Path, layers: Iterable[Table] = ()) -> CampaignSettings:
    """A campaign's file; files that it names are looked for beside it.

    Args:
        path: TOML.
        layers: Settings of all runs on top of those in the file.

    Raises:
        ConfigError: It cannot be read, or a key is unknown or of the wrong type.
    """
    table = read_table(path, "campaign file")
    campaign = validated(CampaignSettings, table, where=str(path), see=SEE)
    folder = path.absolute().parent
    whole = {
        key: tuple(absolute(name, folder) for name in getattr(campaign, key)) for key in _LISTS
    }
    return campaign.model_copy(
        update={
            **whole,
            "set": overlaid([settled(campaign.set, folder), *layers]),
            "set_for": {
                absolute(name, folder): settled(table, folder)
                for name, table in campaign.set_for.items()
            },
        }
    )


def chains(campaign: CampaignSettings) -> tuple[Chain, ...]:
    """All runs of a campaign, in the order of its tables; everything is checked first.

    Raises:
        ConfigError: A name or a setting is not usable, or two runs would be called the same.
    """
    _check_settings(campaign)
    lists = [getattr(campaign, key) or (None,) for key in _LISTS if key != "planners"]
    planners = sorted(campaign.planners or (None,), key=lambda planner: planner != FIRST)
    found = []
    for chosen in product(*lists):
        at_seed_0 = [_config(campaign, (*chosen, planner)) for planner in planners]
        for config in at_seed_0:
            _check(config)
        found += [
            Chain(
                tuple(run.model_copy(update={"seed": seed}) for run in at_seed_0),
                campaign.same_scans,
            )
            for seed in campaign.seeds
        ]
    _check_names(found)
    return tuple(found)


def _config(campaign: CampaignSettings, chosen: tuple[str | None, ...]) -> Config:
    """The config of one combination, in the order of `_LISTS`.

    A sonar's name stands below the settings, which may change some of its figures.
    """
    names = dict(zip(_LISTS.values(), chosen, strict=True))
    scenario, sonar, navigation = (names.pop(key) for key in ("scenario", "sonar", "navigation"))
    assert scenario is not None
    below: Table = {key: name for key, name in names.items() if name is not None}
    if sonar is not None:
        below["sonar"] = {"preset": sonar}
    own = [campaign.set_for[name] for name in chosen if name in campaign.set_for]
    above: list[Table] = []
    exact = {"pose_noise": PoseNoiseSettings().model_dump()}
    if navigation == "none":
        above = [{"vehicle": {"name": TELEPORT} | exact}]
    elif navigation == "noise":
        above = [{"vehicle": {"name": TELEPORT}}]
    elif navigation is not None:
        above = [{"vehicle": {"navigation": navigation} | exact}]
    config = scenario_config(scenario, [below, campaign.set, *own, *above])
    if navigation in ("truth", "dvl") and config.vehicle.name == TELEPORT:
        raise ConfigError(
            f"navigation {navigation!r} needs a vehicle; give set.vehicle.name, as in "
            '[set.vehicle] name = "bluerov2"'
        )
    if navigation == "noise" and not config.vehicle.is_noisy:
        raise ConfigError(
            "navigation 'noise' needs poses that are off; give some, as in "
            "[set.vehicle.pose_noise] position_m = 0.05"
        )
    return config


def _check_settings(campaign: CampaignSettings) -> None:
    """Refuse settings of what the campaign's lists choose, and of what is not in them."""
    names = [name for key in _LISTS for name in getattr(campaign, key)]
    for name in campaign.set_for:
        if name not in names:
            raise ConfigError(
                f"set_for.{name}: nothing of that name is in the campaign"
                f"{did_you_mean(name, names, SEE)}"
            )
    for where, table in [("set", campaign.set)] + [
        (f"set_for.{name}", table) for name, table in campaign.set_for.items()
    ]:
        for key, inner in table.items():
            listed = {one: many for many, one in _LISTS.items() if getattr(campaign, many)}
            many = "seeds" if key == "seed" else listed.get(key)
            if key == "sonar" and isinstance(inner, dict) and "preset" not in inner:
                many = None
            if key == "vehicle" and isinstance(inner, dict) and "navigation" in inner:
                key, many = "vehicle.navigation", listed.get("navigation")
            if many is not None:
                raise ConfigError(f"{where}.{key}: the campaign's {many} choose it; leave it out")


def _check(config: Config) -> None:
    """Bad input shows before the first run."""
    for what, own in (("planner", config.planner), ("mapper", config.mapper)):
        if is_plugin(own):
            load_plugin(own, what)
    if config.vehicle.name != TELEPORT:
        vehicle_named(config.vehicle.name)


def _check_names(found: Iterable[Chain]) -> None:
    """Refuse runs that the tables could not tell apart."""
    seen = set()
    for run in chain.from_iterable(one.runs for one in found):
        names = factors(run)
        told = tuple(names.values())
        if told in seen:
            text = ", ".join(f"{key} {value}" for key, value in names.items())
            raise ConfigError(f"two runs would both be {text}; name each thing once")
        seen.add(told)


def factors(config: Config) -> dict[str, Any]:
    """What a run is known by in tables, with the keys of `FACTORS`."""
    vehicle = config.vehicle
    believed = "noise" if vehicle.is_noisy else "none"
    return {
        "scenario": config.scenario,
        "sonar": config.sonar.name,
        "model": config.model,
        "navigation": believed if vehicle.name == TELEPORT else vehicle.navigation,
        "mapper": config.mapper,
        "planner": config.planner,
        "seed": config.seed,
    }


def with_scans(config: Config, scans: int) -> Config:
    """The same with so many scans for a planner whose plan is fixed; one at least."""
    survey = config.survey.model_copy(update={"baseline_scans": max(1, scans)})
    return config.model_copy(update={"survey": survey})


def run_key(config: Config) -> str:
    """The hash by which a run's result is found again.

    It is of the config, of the files that the config names, and of insonify's version.
    """
    table = config.model_dump(mode="json")
    told = {"config": table, "files": list(_digests(table)), "insonify": [__version__, _SCHEMA]}
    text = json.dumps(told, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:24]


def _digests(table: Table) -> Iterator[str]:
    """Of the files that a config names, each by its content."""
    for holder, key in named_files(table):
        value = holder[key]
        file = Path(value.partition(".py:")[0] + ".py" if ".py:" in value else value)
        if file.suffix and file.is_file():
            yield _digest(file, file.stat().st_mtime_ns)


@lru_cache
def _digest(file: Path, changed_ns: int) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()
