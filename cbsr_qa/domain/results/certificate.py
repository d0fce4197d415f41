"""Content of a calibration certificate, independent of page and XML."""

from dataclasses import dataclass
from datetime import date, datetime

from cbsr_qa.domain.plan.plan import CertificateSettings
from cbsr_qa.domain.plan.standards import ReferenceStandard, StandardRole, find_standard
from cbsr_qa.domain.results.expanded_force import ExpandedForce
from cbsr_qa.domain.run.run import RunIdentity

#: What a certificate says where nothing was stated.
NOT_STATED = "not stated"
#: What it says where no instrument tells.
NOT_MEASURED = "not measured"


def is_reference_known(identity: RunIdentity, standards: tuple[ReferenceStandard, ...]) -> bool:
    """Whether the load cell's certificate was stated, without which U lacks its error; a simulated run needs none."""
    return bool(identity.simulated) or find_standard(standards, StandardRole.LOAD_CELL) is not None


@dataclass(frozen=True, slots=True)
class Customer:
    """Customer of a certificate; empty texts were not stated."""

    name: str = ""
    address: str = ""


@dataclass(frozen=True, slots=True)
class Replacement:
    """A certificate that another one replaces.

    Parameters
    ----------
    number, dcc_sha256 : its number, and the SHA-256 of its XML.
    why : why it is replaced.
    revoked : when, by whom and why it was revoked before, in words; empty if it stood.
    """

    number: str
    why: str
    dcc_sha256: str
    revoked: str = ""


@dataclass(frozen=True, slots=True)
class CheckedLoad:
    """A load that the calibration was not learned from, and the force that the calibrated sensor indicated.

    Parameters
    ----------
    phase : phase of the run.
    reference_N : mean of the load cell from the last frame of the hold to its end.
    indicated_N : by the calibration, from that frame, the place known.
    expanded : uncertainty of the error that this press shows.
    max_error_N : maximum permissible error; None without a requirement.
    outcome : decision, a word of :class:`cbsr_qa.stats.conformity.Conformity`; empty without a requirement.
    conformance : probability that the true error is within its maximum; None without a requirement.
    """

    phase: str
    reference_N: float
    indicated_N: float
    expanded: ExpandedForce
    max_error_N: float | None = None
    outcome: str = ""
    conformance: float | None = None

    @property
    def error_N(self) -> float:
        return self.indicated_N - self.reference_N


@dataclass(frozen=True, slots=True)
class LeftOutLoad:
    """A load that the calibration was not learned from, and that is not checked.

    Parameters
    ----------
    phase, place_mm : phase of the run, and place from the sheet's centre.
    why : why there is no error; empty for a load outside of the stated range.
    reference_N, indicated_N : as of a checked load; None where load cell or calibration tells no force.
    """

    phase: str
    place_mm: tuple[float, float]
    why: str
    reference_N: float | None = None
    indicated_N: float | None = None

    @property
    def error_N(self) -> float | None:
        """None where the load cell or the calibration tells no force."""
        if self.reference_N is None or self.indicated_N is None:
            return None
        return self.indicated_N - self.reference_N


@dataclass(frozen=True, slots=True)
class Certificate:
    """Everything that a certificate states.

    Parameters
    ----------
    number : unique: the laboratory's prefix and the run.
    issued_at : wall clock, UTC.
    settings : laboratory, place, signatory, validity and decision rule.
    identity : run with its sensor, station, recipe, operator and software.
    calibration, calibration_digest : calibration that is certified, and the SHA-256 of its content.
    performed : first and last day of the calibration (UTC).
    recipe_digest : SHA-256 of the recipe's content.
    verdict : of the recipe's limits, an override included.
    sensor, head : sensor type and head in words.
    temperature_C : lowest and highest; None if it was not measured.
    range_N, radius_mm : forces, and distance from the centre, for which the calibration is valid.
    standards : those that were stated.
    forces, forces_in_use : results: force with U at stated places, on the day of calibration; the same in use.
    checked : loads that the calibration was not learned from, within its range.
    left_out : all other loads that it was not learned from.
    deviations : checks before the run that a person overrode, then warnings of its latest analysis and of the run.
    reduced : why the calibration's range is smaller than intended.
    valid_until : None: no validity is stated.
    replaced : the certificate that this one replaces; None without.
    """

    number: str
    issued_at: datetime
    settings: CertificateSettings
    customer: Customer
    identity: RunIdentity
    calibration: str
    calibration_digest: str
    performed: tuple[date, date]
    recipe_digest: str
    verdict: str
    sensor: str
    head: str
    temperature_C: tuple[float, float] | None
    range_N: tuple[float, float]
    radius_mm: float
    standards: tuple[ReferenceStandard, ...]
    forces: tuple[ExpandedForce, ...]
    forces_in_use: tuple[ExpandedForce, ...]
    checked: tuple[CheckedLoad, ...]
    left_out: tuple[LeftOutLoad, ...]
    deviations: tuple[str, ...]
    reduced: tuple[str, ...]
    valid_until: date | None
    replaced: Replacement | None

    @property
    def condition(self) -> str:
        """State of the item when it was calibrated, in words."""
        return f"verdict of the recipe's limits: {self.verdict}"

    @property
    def is_judged(self) -> bool:
        """Whether errors are compared with a requirement: not if the load cell that tells them is not stated."""
        return self.settings.judges and is_reference_known(self.identity, self.standards)

    @property
    def outcome(self) -> str:
        """The worst decision about a checked load; empty without a requirement."""
        order = ("fail", "conditionalFail", "conditionalPass", "pass")
        return min((load.outcome for load in self.checked if load.outcome), key=order.index, default="")
