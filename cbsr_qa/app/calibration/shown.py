"""The outcome of ``cbsr-qa calibration show``: contents of a calibration file, without its arrays."""

from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any, Final, Self

import numpy as np

from cbsr_qa.calibration.abilities import ForceAbility, describe_abilities
from cbsr_qa.calibration.file.content import FLAG, INDEX, PURE, TEXT, Entry
from cbsr_qa.calibration.file.entries import encode
from cbsr_qa.calibration.force.interpolation import interpolate
from cbsr_qa.calibration.uncertainty.budget import evaluate_forces
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.domain.plan.standards import ReferenceStandard, describe_force_error
from cbsr_qa.domain.results.calibration import (
    BaselineConductance,
    Calibration,
    ForceModel,
    SettlingSummary,
    VerifiedFile,
)
from cbsr_qa.domain.results.expanded_force import BudgetComponent, ExpandedForce, Result
from cbsr_qa.domain.sensor.sensor_type import Parameter, QuasiStatic

#: Largest number of values of an array that is shown.
_MOST_SHOWN: Final = 8


@dataclass(frozen=True, slots=True)
class CalibratedSensor:
    """The calibrated sensor, and the origin of its calibration."""

    calibration: str
    run: str
    issued_at: str
    serial: str
    batch: str
    sensor_type: str


@dataclass(frozen=True, slots=True)
class RangeOfUse:
    """Where a calibration may be used; see :class:`~cbsr_qa.domain.results.calibration.Validity`."""

    force_N: tuple[float, float] | None
    strain: tuple[float, float]
    temperature_C: tuple[float, float] | None
    radius_mm: float
    reduced: tuple[str, ...]
    indenter_diameter_mm: float
    indenter: str


@dataclass(frozen=True, slots=True)
class ShownParameter:
    """A material parameter with its units; see :class:`~cbsr_qa.domain.sensor.sensor_type.Parameter`."""

    value: float
    stderr: float | None
    source: str
    units: str


@dataclass(frozen=True, slots=True)
class ShownLine:
    """Relative conductance change against stress or strain; see ``QuasiStatic``."""

    slope: ShownParameter
    intercept: ShownParameter
    covariance: float | None

    @classmethod
    def from_line(cls, line: QuasiStatic, units: str) -> Self:
        """Return a line whose slope has these units."""

        def with_units(parameter: Parameter, units: str) -> ShownParameter:
            return fill_from_object(ShownParameter, parameter, units=units)

        return cls(with_units(line.slope, units), with_units(line.intercept, "1"), line.covariance)


@dataclass(frozen=True, slots=True)
class Settling:
    """Settling times of a signal; see :class:`~cbsr_qa.domain.results.calibration.SettlingSummary`."""

    signal: str
    direction: str
    mean_s: float | None
    deviation_s: float | None
    accepted: int
    censored: int
    rejected: int

    @classmethod
    def from_summary(cls, summary: SettlingSummary) -> Self:
        return fill_from_object(cls, summary, direction="loading" if summary.loading else "unloading")


@dataclass(frozen=True, slots=True)
class Value:
    """A field of the file: one value, or the shape of an array that is not shown.

    Parameters
    ----------
    value : number, flag or text, or a tuple of at most :data:`_MOST_SHOWN`; None if not measured, and for longer
        arrays.
    shape : lengths of an array's axes; empty for one value.
    """

    value: float | str | tuple[float | str, ...] | None
    units: str
    shape: tuple[int, ...]

    @classmethod
    def from_entry(cls, entry: Entry) -> Self:
        units = "" if entry.units in (PURE, TEXT, INDEX, FLAG) else entry.units
        if isinstance(entry.value, str):
            return cls(entry.value, units, ())
        flat_values = np.ravel(np.array(entry.value, dtype=object)).tolist()
        is_finite = all(isfinite(value) for value in flat_values if isinstance(value, float))
        shape = np.shape(entry.value)
        if not shape:
            return cls(flat_values[0] if is_finite else None, units, ())
        return cls(tuple(flat_values) if is_finite and len(flat_values) <= _MOST_SHOWN else None, units, shape)

    @property
    def listed(self) -> bool:
        """Whether it is listed for people: not a long array."""
        return not self.shape or self.value is not None

    @property
    def text(self) -> str:
        if self.value is None:
            return "not measured"
        each = self.value if isinstance(self.value, tuple) else (self.value,)
        return ", ".join(f"{one:.6g}" if isinstance(one, float) else str(one) for one in each) or "–"


@dataclass(frozen=True, slots=True)
class ShownForceModel:
    """The force model in numbers: its map over the calibrated places, and the least force that one frame detects.

    Parameters
    ----------
    places : nodes of the lattice where the head may be.
    response_lowest, response_highest : response of the sheet relative to that of its material.
    scatter : scatter of single loads, relative.
    hold_s : time after the press at which the map was learned [s].
    """

    places: int
    lattice_spacing_mm: float
    response_lowest: float
    response_highest: float
    response_stderr_lowest: float
    response_stderr_highest: float
    scatter: float
    stress_kPa: tuple[float, float]
    hold_s: float
    threshold: float
    least_force_centre_N: float
    least_force_worst_N: float
    least_force_worst_at_mm: tuple[float, float]
    head: str
    assumed: tuple[str, ...]

    @classmethod
    def from_model(cls, calibration: Calibration, model: ForceModel) -> Self:
        ability = ForceAbility.from_calibration(calibration, model)
        places, least_N = ability.places_mm, ability.least_N
        response = np.exp(interpolate(model, model.log_response, places))
        stderr = interpolate(model, model.log_response_stderr, places)
        worst_place = int(np.argmax(least_N))
        return fill_from_object(
            cls,
            model,
            places=len(places),
            lattice_spacing_mm=model.lattice.spacing_mm,
            response_lowest=float(response.min()),
            response_highest=float(response.max()),
            response_stderr_lowest=float(stderr.min()),
            response_stderr_highest=float(stderr.max()),
            hold_s=model.steady_s,
            least_force_centre_N=float(least_N[np.argmin(np.hypot(*places.T))]),
            least_force_worst_N=float(least_N[worst_place]),
            least_force_worst_at_mm=(float(places[worst_place, 0]), float(places[worst_place, 1])),
            head=calibration.indenter.words(),
            assumed=tuple(name for name in calibration.assumed if name.endswith("stress")),
        )


@dataclass(frozen=True, slots=True)
class ShownComponent:
    """An input of a force's budget; see :class:`~cbsr_qa.domain.results.expanded_force.BudgetComponent`.

    Parameters
    ----------
    standard_uncertainty_N : |c| u(x), what the input adds to the force.
    dof : degrees of freedom; None if infinite.
    """

    name: str
    kind: str
    standard_uncertainty_N: float
    dof: float | None
    share: float
    source: str
    shared: bool

    @classmethod
    def from_component(cls, part: BudgetComponent) -> Self:
        return fill_from_object(
            cls,
            part,
            standard_uncertainty_N=part.standard_uncertainty,
            dof=part.dof if isfinite(part.dof) else None,
        )


@dataclass(frozen=True, slots=True)
class ShownUncertainty:
    """An expanded uncertainty; see :class:`~cbsr_qa.domain.results.expanded_force.ExpandedForce`.

    Parameters
    ----------
    dof : effective degrees of freedom; None if infinite.
    components : inputs in the sum, by falling share.
    not_stated : inputs that nothing gives a number for, which U lacks.
    monte_carlo_N, monte_carlo_why : interval of 95 % by random numbers where the law of propagation may not do, and
        why not; else None and empty.
    """

    standard_uncertainty_N: float
    dof: float | None
    k: float
    U_N: float
    components: tuple[ShownComponent, ...]
    not_stated: tuple[str, ...]
    monte_carlo_N: tuple[float, float] | None
    monte_carlo_why: str

    @classmethod
    def from_force(cls, expanded: ExpandedForce, **others: Any) -> Self:
        simulated = expanded.monte_carlo
        return fill_from_object(
            cls,
            expanded,
            dof=expanded.dof if isfinite(expanded.dof) else None,
            components=tuple(map(ShownComponent.from_component, expanded.components)),
            monte_carlo_N=None if simulated is None else (simulated.low, simulated.high),
            monte_carlo_why="" if simulated is None else simulated.why,
            **others,
        )


@dataclass(frozen=True, slots=True)
class ShownExpandedForce(ShownUncertainty):
    """A force with its expanded uncertainty on the day of calibration, and in use."""

    place_mm: tuple[float, float]
    force_N: float
    settling_s: float
    in_use: ShownUncertainty


@dataclass(frozen=True, slots=True)
class ShownCalibration:
    """Contents of a calibration file.

    Parameters
    ----------
    digest, record_digest : SHA-256 of the file's content, and of the part kept in the database.
    values : every field of the file by its path, as named in its field table (``Calibration``).
    abilities : what the sensor does, in sentences.
    force_error : what standard errors of force include.
    expanded_forces : forces over the range with U and k.
    no_expanded_forces : why there are none; None where there are.
    """

    file: Path
    digest: str
    record_digest: str
    schema_version: int
    identity: CalibratedSensor
    simulated: tuple[str, ...]
    abilities: tuple[str, ...]
    validity: RangeOfUse
    baseline_conductance: tuple[BaselineConductance, ...]
    against_stress: ShownLine
    against_strain: ShownLine
    assumed: tuple[str, ...]
    settling: tuple[Settling, ...]
    values: dict[str, Value]
    force_model: ShownForceModel | None
    no_force_model: str | None
    force_error: str
    standards: tuple[ReferenceStandard, ...]
    expanded_forces: tuple[ShownExpandedForce, ...]
    no_expanded_forces: str | None

    @classmethod
    def from_calibration(cls, path: Path, verified: VerifiedFile, held: Calibration) -> Self:
        """Return the contents of a file that was verified."""
        head = held.indenter
        expanded, why_not = _expand_forces(held)
        return cls(
            file=path,
            digest=verified.digest,
            record_digest=verified.record_digest,
            schema_version=verified.schema_version,
            identity=fill_from_object(
                CalibratedSensor, held.sensor, calibration=held.calibration, run=held.run, issued_at=held.issued_at
            ),
            simulated=held.simulated,
            abilities=tuple(describe_abilities(held)),
            validity=fill_from_object(
                RangeOfUse, held.validity, indenter_diameter_mm=head.diameter_mm, indenter=head.words()
            ),
            baseline_conductance=held.baseline,
            against_stress=ShownLine.from_line(held.against_stress, "1/kPa"),
            against_strain=ShownLine.from_line(held.against_strain, "1"),
            assumed=held.assumed,
            settling=tuple(map(Settling.from_summary, held.settling)),
            values={path: Value.from_entry(entry) for path, entry in sorted(encode(held).items())},
            force_model=None if held.force is None else ShownForceModel.from_model(held, held.force),
            no_force_model=None if held.force else held.no_force,
            force_error=describe_force_error(held.standards),
            standards=held.standards,
            expanded_forces=expanded,
            no_expanded_forces=why_not,
        )


def _expand_forces(held: Calibration) -> tuple[tuple[ShownExpandedForce, ...], str | None]:
    """Return forces over the range, or why no uncertainty can be stated."""
    try:
        on_the_day, in_use = (evaluate_forces(held, result=when) for when in (Result.ON_THE_DAY, Result.IN_USE))
    except CalibrationError as error:
        return (), error.reason
    expanded = tuple(
        ShownExpandedForce.from_force(day, in_use=ShownUncertainty.from_force(use))
        for day, use in zip(on_the_day, in_use, strict=True)
    )
    return expanded, None
