"""Checks and control charts of a station: check results, chart references and standing signals."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.readings.frames import FrameBlock
from cbsr_qa.domain.run.run import InstrumentIdentity


class CheckOutcome(StrEnum):
    """Outcome of one line of a check, or of the whole check."""

    OK = "ok"
    WARNING = "warning"  #: does not forbid a run, but needs attention
    FAILED = "failed"
    NOT_DONE = "not done"  #: not requested, or impossible at this station; never a pass


#: Outcomes from worst to best: a check is as good as its worst line.
_SEVERITY = (CheckOutcome.FAILED, CheckOutcome.WARNING, CheckOutcome.OK, CheckOutcome.NOT_DONE)


@dataclass(frozen=True, slots=True)
class CheckResult:
    """One line of a check.

    Parameters
    ----------
    name : name of what was looked at, e.g. ``"gain error"``.
    value : a number, where it is one; never NaN.
    unit : unit of the value; empty where it has none.
    allowed : allowed values in words; empty where nothing limits the value.
    remedy : remedy; empty where all is well.
    said : the finding in words, where a number does not say it all.
    subject : whom it is about: a role of the station file, ``"reference ring"``, ``"golden sensor S-7"``.
    """

    name: str
    outcome: CheckOutcome
    value: float | None = None
    unit: str = ""
    allowed: str = ""
    remedy: str = ""
    said: str = ""
    subject: str = ""

    def __post_init__(self) -> None:
        if self.value is not None and not abs(self.value) < float("inf"):
            raise RefusedError(f"check {self.name}: {self.value} is not a finite number")


class CheckSeal(StrEnum):
    """Whether a stored check can be told from one that was altered."""

    NONE = "none"  #: nothing would tell
    DIGEST = "digest"
    SIGNED = "signed"
    NOT_CHECKED = "signature not checked"  #: with another key than the one that is set, if one is


@dataclass(frozen=True, slots=True)
class StationCheck:
    """One check of a station.

    Parameters
    ----------
    check : time-ordered UUID as text.
    station, operator : names; the operator may be empty.
    checked_at : wall clock, with time zone.
    sensor_type : the station was set up for.
    configuration_digest : SHA-256 of the merged configuration it was checked with.
    software : distribution name → version.
    instruments : those that answered, as they identified themselves.
    golden_run : run of the golden sensor, where one was measured.
    sealed : state of its seal.
    altered : description of what does not match the seal; the check has one line then, which says so, and has failed.
        Empty where nothing does.
    """

    check: str
    station: str
    operator: str
    checked_at: datetime
    sensor_type: str
    configuration_digest: str
    software: tuple[tuple[str, str], ...]
    instruments: tuple[InstrumentIdentity, ...]
    results: tuple[CheckResult, ...]
    golden_run: str | None = None
    sealed: CheckSeal = field(default=CheckSeal.NONE, compare=False)
    altered: str = ""

    @property
    def outcome(self) -> CheckOutcome:
        """The worst outcome of its lines, NOT_DONE of none."""
        return worst_check(self.results)

    def lines(self, outcome: CheckOutcome) -> tuple[CheckResult, ...]:
        return tuple(line for line in self.results if line.outcome is outcome)


@dataclass(frozen=True, slots=True, eq=False)
class RingReadings:
    """Frames of a resistor ring connected in place of a sensor.

    Parameters
    ----------
    resistances_ohm : (electrodes,) the first joins electrodes 0 and 1, the last the last one and 0.
    """

    frames: FrameBlock
    resistances_ohm: tuple[float, ...]


def worst_check(results: Sequence[CheckResult]) -> CheckOutcome:
    """Return the worst outcome of some lines, NOT_DONE of none."""
    return min((line.outcome for line in results), key=_SEVERITY.index, default=CheckOutcome.NOT_DONE)
