"""What commands say of plugins: which there are, and what each takes and measures."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

from pydantic import Field


@dataclass(frozen=True, slots=True)
class OptionReference:
    """One option: unit, allowed values, default as TOML (may be empty) and description."""

    name: str
    unit: str
    allowed: str
    default: str
    required: bool
    description: str


@dataclass(frozen=True, slots=True)
class PluginReference:
    """Description and options of a plugin, and the measurements of a metric with their units."""

    kind: str
    name: str
    summary: str
    options: tuple[OptionReference, ...]
    measures: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class ListedPlugin:
    """A registered plugin, the distribution it comes from, and with ``--options`` what it does and takes."""

    kind: str
    name: str
    distribution: Annotated[str, Field(serialization_alias="from")]
    version: str
    options: tuple[OptionReference, ...] | None = None
    summary: str | None = None


@dataclass(frozen=True, slots=True)
class FailedPlugin:
    """A distribution whose plugins could not be loaded."""

    distribution: Annotated[str, Field(serialization_alias="from")]
    reason: str


@dataclass(frozen=True, slots=True)
class ShownPlugins:
    """Every plugin of one name, with its options and measurements."""

    plugins: tuple[PluginReference, ...]


@dataclass(frozen=True, slots=True)
class ListedPlugins:
    """Plugins by kind and name, and those that could not be loaded."""

    plugins: tuple[ListedPlugin, ...]
    failed: tuple[FailedPlugin, ...]
