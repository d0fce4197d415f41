"""Checks before a run, and how strictly a station holds to each."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final


class GateCheck(StrEnum):
    """Checks before a run, in the order of the answers."""

    SERIAL_PATTERN = "serial_pattern"  #: the serial number fits the pattern of the sensor type
    RETEST = "retest"  #: the sensor has not passed this recipe yet, or may be tested again
    PARTS = "parts"  #: no part that is unique is of another sensor
    CALIBRATION_DUE = "calibration_due"  #: no instrument is past its calibration date
    GOLDEN = "golden"  #: a golden sensor was measured not long ago, and passed
    CHARTS = "charts"  #: no control chart of the station signals
    DISK = "disk"  #: there is room for what the run writes
    OPERATOR = "operator"  #: the operator is on the station's list, with the right PIN
    RELEASED = "released"  #: somebody released every file the run is configured by
    BACKLOG = "backlog"  #: nothing has waited too long for the central database
    BEFORE_RUN = "before_run"  #: no plugin vetoes


class GatePolicy(StrEnum):
    """Consequence of a check that does not pass."""

    REFUSE = "refuse"
    WARN = "warn"
    OFF = "off"  #: it is not asked


#: Policies of a station file without a ``[gate]`` table.
GATE_DEFAULTS: Final[Mapping[GateCheck, GatePolicy]] = dict.fromkeys(GateCheck, GatePolicy.OFF) | {
    GateCheck.SERIAL_PATTERN: GatePolicy.REFUSE,  # only of a sensor type that states one
    GateCheck.PARTS: GatePolicy.WARN,  # only of parts that the sensor type calls unique
    GateCheck.CALIBRATION_DUE: GatePolicy.WARN,
    GateCheck.BEFORE_RUN: GatePolicy.REFUSE,  # only with a plugin that implements it
}


@dataclass(frozen=True, slots=True)
class Operator:
    """Somebody who may run a station; ``pin`` is a salted hash (:mod:`cbsr_qa.system.pins`), or empty."""

    name: str
    pin: str = field(default="", repr=False)


@dataclass(frozen=True, slots=True)
class GateSettings:
    """How strictly a station checks before a run.

    Parameters
    ----------
    policies : policies of checks; those left out have :data:`GATE_DEFAULTS`.
    retest_runs : most finished runs of a sensor and recipe; None for any number until one passes.
    golden_hours, golden_runs : longest time [h] and most runs since the golden sensor; None for no such limit.
    disk_GB : least free space [10⁹ bytes]; None for an estimate from the plan of the run.
    operators : operators who may run the station.
    before_run_s : time a plugin may take to answer [s].
    """

    policies: Mapping[GateCheck, GatePolicy] = field(default_factory=dict)
    retest_runs: int | None = None
    golden_hours: float | None = None
    golden_runs: int | None = None
    disk_GB: float | None = None
    operators: tuple[Operator, ...] = ()
    before_run_s: float = 10.0

    def policy(self, check: GateCheck) -> GatePolicy:
        return self.policies.get(check, GATE_DEFAULTS[check])
