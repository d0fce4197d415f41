"""Requests to the gate, and findings of its checks."""

from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime
from difflib import get_close_matches
from pathlib import Path
from typing import NamedTuple, Self

from cbsr_qa.config.merging import Configuration
from cbsr_qa.config.serials import validate_operator, validate_reason
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.plan.gate import GateCheck, GateSettings
from cbsr_qa.domain.sensor.sensor_type import SensorIdentity, SensorPart
from cbsr_qa.plugin.discovery import Plugins
from cbsr_qa.store.repository import Repository
from cbsr_qa.system.words import echo


@dataclass(frozen=True, slots=True)
class Override:
    """Checks that may not refuse this run, by whom and for what reason."""

    checks: tuple[str, ...] = ()
    by: str = ""
    why: str = ""

    def validate(self) -> Self:
        """Return itself. Raise ConfigError if a check is unknown, or name or reason is missing or not allowed."""
        known_checks = [str(check) for check in GateCheck]
        for name in self.checks:
            if name not in known_checks:
                near = get_close_matches(name, known_checks, n=1)
                hint = f"did you mean {near[0]!r}? " if near else ""
                remedy = f"{hint}checks: {', '.join(known_checks)}"
                raise ConfigError(f"there is no check {echo(name)} to override", remedy=remedy)
        if not self.checks:
            if self.by or self.why:
                raise ConfigError("an override needs --override", remedy=f"name a check: {', '.join(known_checks)}")
            return self
        text_by_option = {"--override-by": self.by, "--override-why": self.why}
        absent = [option for option, text in text_by_option.items() if not text.strip()]
        if absent:
            raise ConfigError(f"an override needs {' and '.join(absent)}", remedy="say who decides, and why")
        validate_operator(self.by)
        validate_reason(self.why)
        return self


@dataclass(frozen=True, slots=True)
class GateRequest:
    """A run that wants to begin, or to be resumed.

    Parameters
    ----------
    serial, batch, operator, parts : checked names.
    override : checked override.
    golden : whether the run measures the golden sensor of a station check.
    resumed : whether the run goes on with earlier loads.
    pin : asks for the operator's PIN; None if nobody can be asked. Called only if the station file has one.
    preview : whether the answers are only shown; no PIN is asked for.
    tested_by : name of another process that tests the sensor with this recipe now; empty for none.
    database : URL.
    folders : other folders the run writes to.
    """

    serial: str
    database: str
    folders: tuple[Path, ...]
    batch: str = ""
    operator: str = ""
    override: Override = field(default_factory=Override)
    golden: bool = False
    resumed: bool = False
    pin: Callable[[str], str] | None = None
    preview: bool = False
    tested_by: str = ""
    parts: tuple[SensorPart, ...] = ()


class Finding(NamedTuple):
    """What a check found: whether all is well (None: there was nothing to check), in words, and what to do.

    ``remedy`` is for people wherever they are, ``command`` is how to do it at the command line.
    """

    well: bool | None
    words: str
    remedy: str = ""
    command: str = ""


@dataclass(frozen=True, slots=True)
class Asked:
    """All that a check may look at; ``store`` is None as long as there is no database."""

    request: GateRequest
    configuration: Configuration
    plugins: Plugins
    store: Repository | None
    now: datetime

    @property
    def settings(self) -> GateSettings:
        return self.configuration.station.gate

    @property
    def sensor(self) -> SensorIdentity:
        return SensorIdentity(self.request.serial, self.request.batch, self.configuration.sensor_type.name)
