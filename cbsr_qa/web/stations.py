"""The stations that are served, and the recipes a run may be started with: all that a request can choose from."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from cbsr_qa.config.documents import DocumentKind, list_shipped
from cbsr_qa.config.loader import load_recipe, load_station
from cbsr_qa.domain.errors import ConfigError, RefusedError
from cbsr_qa.domain.plan.gate import GateCheck, GatePolicy
from cbsr_qa.domain.plan.plan import Station
from cbsr_qa.plugin.discovery import Plugins, discover

#: Form of a station's name, which is part of addresses.
_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._ -]*")


@dataclass(frozen=True, slots=True)
class OfferedRecipe:
    """A recipe that may be chosen. ``source`` is what ``--recipe`` takes, ``name`` what the page shows."""

    name: str
    source: str


@dataclass(frozen=True, slots=True)
class ServedStation:
    """A station of the page.

    Parameters
    ----------
    source : value of ``--station``.
    recipes : recipes that may be started here; the first is the default.
    """

    name: str
    source: str
    station: Station
    recipes: tuple[OfferedRecipe, ...]

    @property
    def asks_operator(self) -> bool:
        """Whether the gate asks who works here."""
        return self.station.gate.policy(GateCheck.OPERATOR) is not GatePolicy.OFF

    @property
    def simulated(self) -> bool:
        """Whether the station file says that instruments are simulated: a virtual clock has no others."""
        return self.station.clock == "virtual" or any(spec.emulated for spec in self.station.instruments)

    def recipe(self, name: str) -> OfferedRecipe:
        """Return an offered recipe. RefusedError if it is not offered."""
        for recipe in self.recipes:
            if recipe.name == name:
                return recipe
        offered = ", ".join(recipe.name for recipe in self.recipes)
        raise RefusedError(f"recipe {name[:64]!r} is not offered here", remedy=f"offered: {offered}")


def load_stations(stations: Sequence[str], recipes: Sequence[str]) -> tuple[ServedStation, ...]:
    """Load stations and recipes.

    Parameters
    ----------
    stations, recipes : files or names of shipped ones; without recipes, the shipped ones are offered.

    Raises
    ------
    ConfigError
        If a file is missing or wrong, a name cannot be part of an address, or two have the same name.
    """
    plugins = discover()
    offered = _load_recipes(recipes, plugins)
    served = tuple(_load_station(source, offered, plugins) for source in stations)
    _check_unique("station", [(station.name, station.source) for station in served])
    return served


def _load_station(source: str, offered: tuple[OfferedRecipe, ...], plugins: Plugins) -> ServedStation:
    station = load_station(source, plugins).value
    if not _NAME.fullmatch(station.name):
        raise ConfigError(
            f"station {source}: the name {station.name!r} cannot be part of an address",
            remedy="allowed: letters, digits, spaces and . _ -, starting with a letter or a digit",
        )
    return ServedStation(station.name, source, station, offered)


def _load_recipes(recipes: Sequence[str], plugins: Plugins) -> tuple[OfferedRecipe, ...]:
    sources = tuple(recipes)
    if not sources:  # the shipped ones for a line, the shortest production test first
        sources = tuple(sorted(list_shipped(DocumentKind.RECIPE), key=lambda name: (name != "nine-locations", name)))
    offered = tuple(OfferedRecipe(load_recipe(source, plugins).value.name, source) for source in sources)
    _check_unique("recipe", [(recipe.name, recipe.source) for recipe in offered])
    return offered


def _check_unique(noun: str, named: Sequence[tuple[str, str]]) -> None:
    source_by_name: dict[str, str] = {}
    for name, source in named:
        if name in source_by_name:
            raise ConfigError(
                f"{source_by_name[name]} and {source} are both {noun} {name!r}",
                remedy=f"give each {noun} its own name",
            )
        source_by_name[name] = source
