"""Inputs of a force's budget: what a calibration states of each, and what nothing gives a number for."""

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import date, datetime
from math import hypot, inf, sqrt
from typing import Final

import numpy as np

from cbsr_qa.calibration.uncertainty.combination import BudgetInput, coverage_factor
from cbsr_qa.calibration.uncertainty.force_point import Entry, ForcePoint
from cbsr_qa.calibration.uncertainty.transients import kernel_error
from cbsr_qa.domain.plan.standards import IN_USE_YEARS, PERCENT, ReferenceStandard, StandardRole, find_standard
from cbsr_qa.domain.results.calibration import Calibration, ForceModel
from cbsr_qa.domain.results.expanded_force import GAIN_DRIFT, Result

_DAYS_A_YEAR: Final = 365.25
#: Standard uncertainty of a rectangle over its width (JCGM 100, 4.3.7).
_OF_WIDTH: Final = 1 / sqrt(12)
#: Degrees of freedom of the scatter by each place that was pressed, which the map's fit tells it by, and the least:
#: found by simulation (docs/explanation/uncertainty.md).
_DOF_OF_PLACE: Final = 0.2
_LEAST_DOF: Final = 2.0
#: Fewest degrees of freedom in a budget: for fewer, Welch and Satterthwaite's formula falls short of random numbers
#: (t of 2 has no variance). An error of fewer is widened to t of 5 with the same 95 %.
_FEWEST_DOF: Final = 5.0
#: Largest difference of two holds, of the calibrated one, that counts as none without a kernel. Chosen by us.
_ALIKE: Final = 0.2


@dataclass(frozen=True, slots=True)
class ForceInput:
    """An input of a force at a point.

    Parameters
    ----------
    name, kind, source, dof, shared : fields of :class:`BudgetInput`.
    entry : where its error enters.
    uncertainty : standard uncertainty of the error there; ``sign`` is that of its effect.
    rectangular : whether the error is as likely anywhere within bounds, and impossible beyond.
    in_runtime : whether the standard error that the runtime gives for a frame has it, beside the shared part.
    widened : how many times larger it is than there.
    """

    name: str
    kind: str
    entry: Entry
    uncertainty: float
    source: str
    dof: float = inf
    shared: bool = False
    sign: float = 1.0
    rectangular: bool = False
    in_runtime: bool = False
    widened: float = 1.0

    def as_input(self, point: ForcePoint) -> BudgetInput:
        """Return the input with its sensitivity."""
        sensitivity = self.sign * point.sensitivity(self.entry)
        return BudgetInput(self.name, self.kind, self.uncertainty, sensitivity, self.source, self.dof, self.shared)


@dataclass(frozen=True, slots=True)
class ForceInputs:
    """Lists the inputs of a calibration's forces.

    Parameters
    ----------
    calibration : calibration as issued, with a force model.
    settling_s : time after the press for which forces are stated.
    """

    calibration: Calibration
    model: ForceModel
    settling_s: float

    def list_at(self, point: ForcePoint, result: Result) -> tuple[list[ForceInput], list[str]]:
        """Return the inputs of a result at a point, and the names of those that nothing gives a number for."""
        listed = [*self._load_cell(point), *self._head(), *self._position(point)]
        if result is not Result.ERROR:  # what map and line miss is part of the error itself
            listed += [*self._map(point), *self._line(point)]
        listed += [*self._transients(point), *self._repeatability(), self._noise(point)]
        if result is Result.IN_USE:
            listed += [*self._temperature(), self._gains(point), "ageing of the sensor"]
        stated = [item for item in listed if isinstance(item, ForceInput)]
        return stated, [item for item in listed if isinstance(item, str)]

    def _load_cell(self, point: ForcePoint) -> Iterator[ForceInput | str]:
        standard = find_standard(self.calibration.standards, StandardRole.LOAD_CELL)
        if standard is None:
            yield from ("load cell", "drift of the load cell", "resolution of the load cell")
            return
        entry = Entry.FACTOR if standard.unit == PERCENT else Entry.NEWTON
        yield ForceInput("load cell", "B", entry, standard.standard_uncertainty, standard.words(), shared=True)
        years = _years_between(standard, self.calibration.issued_at)
        drift = standard.drift_uncertainty(years)
        if drift is None:
            yield "drift of the load cell"
        else:
            since = f"{max(years, 0):.2g} years after {standard.date}"
            source = f"at most {standard.drift_a_year:g} {standard.unit} a year, {since}"
            yield ForceInput("drift of the load cell", "B", entry, drift, source, shared=True, rectangular=True)
        if standard.resolution is None:
            yield "resolution of the load cell"
        else:
            u_N, source = standard.resolution * _OF_WIDTH, f"steps of {standard.resolution:g} N"
            yield ForceInput(
                "resolution of the load cell", "B", Entry.NEWTON, u_N, source, shared=True, rectangular=True
            )

    def _head(self) -> Iterator[ForceInput | str]:
        source = "cancels: the forces are those of the head that calibrated"
        yield ForceInput("area of the head", "B", Entry.FACTOR, 0.0, source, shared=True)
        yield "tilt of the head"

    def _position(self, point: ForcePoint) -> Iterator[ForceInput | str]:
        stage = find_standard(self.calibration.standards, StandardRole.STAGE)
        if stage is None:
            yield "place of indentation"
            return
        u_mm = combine_standard(stage, self.calibration.issued_at)
        yield from name_left_out(stage)
        for axis, slope in zip("xy", point.slope_per_mm.tolist(), strict=True):
            source = f"{stage.words()}; the force changes by {slope:.2%} in 1 mm along {axis}"
            sign = -1.0 if slope < 0 else 1.0
            yield ForceInput(
                f"place of indentation, {axis}", "B", Entry.FACTOR, abs(slope) * u_mm, source, shared=True, sign=sign
            )

    def _map(self, point: ForcePoint) -> Iterator[ForceInput | str]:
        batch, stderr = self.model.batch, point.response_stderr
        source = (
            "how well the presses tell the response at this place, with the noise of readings and load cell in it"
        )
        shared_share = batch.share if batch is not None and batch.alike else 0.0
        yield ForceInput(
            "response of the sheet", "A", Entry.RESPONSE, stderr * sqrt(1 - shared_share), source, in_runtime=True
        )
        if shared_share:
            words = f"{shared_share:.0%} of that response's variance, by model {batch.model[:12]}" if batch else ""
            yield ForceInput(
                "response common to the batch",
                "A",
                Entry.RESPONSE,
                stderr * sqrt(shared_share),
                words,
                in_runtime=True,
            )

    def _line(self, point: ForcePoint) -> Iterator[ForceInput | str]:
        line, name = self.calibration.against_stress, "characteristic of the material"
        if not (line.slope.stderr or line.intercept.stderr):  # earlier calibrations hold 0 where none was stated
            yield name
            return
        stress_kPa = point.force_N / self.calibration.indenter.area_mm2 * 1e3
        # the sign is that of a line that turns about the stress where its error vanishes
        turning = 1.0 if (line.covariance or 0.0) >= 0 else -1.0
        at_stress = (line.intercept.stderr or 0.0) + turning * (line.slope.stderr or 0.0) * stress_kPa
        yield ForceInput(
            name,
            "A" if line.intercept.source.startswith("fitted") else "B",
            Entry.LINE,
            sqrt(float(line.variance(np.array(stress_kPa)))),
            line.intercept.source,
            in_runtime=True,
            shared=True,
            sign=-1.0 if at_stress < 0 else 1.0,
        )

    def _transients(self, point: ForcePoint) -> Iterator[ForceInput | str]:
        name, kernel = "prediction of transients", self.model.loading
        is_known = kernel is not None and len(kernel.weights) > 0
        tolerance_s = 0.0 if is_known else _ALIKE * self.model.steady_s
        if abs(self.settling_s - self.model.steady_s) <= tolerance_s:
            source = f"none: loads are held for {self.settling_s:.3g} s, as those that calibrated"
            yield ForceInput(name, "A", Entry.STRENGTH, 0.0, source)
        elif kernel is None or not is_known:
            yield name
        else:
            relative = kernel_error(kernel, self.settling_s, self.model.steady_s)
            source = f"relaxation of {kernel.loads} loads, from {self.settling_s:.3g} to {self.model.steady_s:.3g} s"
            freedom = max(kernel.scatter_freedom, 1.0)
            yield ForceInput(name, "A", Entry.STRENGTH, relative * abs(point.strength), source, dof=freedom)

    def _repeatability(self) -> Iterator[ForceInput | str]:
        presses = sum(place.loads for place in self.calibration.baseline if place.value is not None)
        places = sum(1 for place in self.calibration.baseline if place.value is not None)
        freedom = max(presses - places + _DOF_OF_PLACE * places, _LEAST_DOF)
        source, widened = f"scatter of {presses} loads at {places} places about their fitted response", 1.0
        if freedom < _FEWEST_DOF:
            widened = coverage_factor(freedom) / coverage_factor(_FEWEST_DOF)
            source += f", times {widened:.3g}: its {freedom:.2g} degrees of freedom count as {_FEWEST_DOF:.0f}"
        yield ForceInput(
            "repeatability",
            "A",
            Entry.RESPONSE,
            self.model.scatter * widened,
            source,
            dof=max(freedom, _FEWEST_DOF),
            in_runtime=True,
            widened=widened,
        )
        left = self.model.residue_strength * hypot(self.model.residue_share, self.model.residue_stderr)
        source = "what earlier loads left before the run's presses, of which a share stays, chosen by us"
        yield ForceInput("residue of earlier loads", "B", Entry.STRENGTH, left, source)

    def _temperature(self) -> Iterator[ForceInput | str]:
        per_C, measured_C = self.calibration.response_per_C, self.calibration.validity.temperature_C
        thermometer = find_standard(self.calibration.standards, StandardRole.THERMOMETER)
        if per_C is None or measured_C is None:
            yield "temperature"
            return
        if thermometer is None:
            yield "thermometer"
        else:
            yield from name_left_out(thermometer)
        reading_C = 0.0 if thermometer is None else combine_standard(thermometer, self.calibration.issued_at)
        u_C = hypot((measured_C[1] - measured_C[0]) * _OF_WIDTH, reading_C)
        source = f"{per_C.value:.2%} a °C, within {measured_C[0]:.3g} to {measured_C[1]:.3g} °C: {per_C.source}"
        yield ForceInput(
            "temperature",
            "B",
            Entry.FACTOR,
            hypot(per_C.value, per_C.stderr or 0.0) * u_C,
            source,
            shared=True,
            rectangular=True,
        )

    def _gains(self, point: ForcePoint) -> ForceInput | str:
        meter = find_standard(self.calibration.standards, StandardRole.SOURCE_METER)
        drift = None if meter is None else meter.drift_uncertainty(IN_USE_YEARS)
        if meter is None or drift is None:
            return GAIN_DRIFT
        source = f"at most {meter.drift_a_year:g} % a year, for use within {IN_USE_YEARS:g} year of the reference"
        return ForceInput(
            GAIN_DRIFT,
            "B",
            Entry.STRENGTH,
            abs(point.gain) * drift,
            source,
            shared=True,
            sign=-1.0 if point.gain < 0 else 1.0,
            rectangular=True,
        )

    def _noise(self, point: ForcePoint) -> ForceInput:
        source = "the run's frames at rest"
        return ForceInput("noise of a frame", "A", Entry.STRENGTH, point.noise, source, in_runtime=True)


def combine_standard(standard: ReferenceStandard, issued_at: str) -> float:
    """Return the standard uncertainty with resolution, and with drift until a day, as far as they are stated."""
    steps = (standard.resolution or 0.0) * _OF_WIDTH
    return hypot(
        standard.standard_uncertainty, steps, standard.drift_uncertainty(_years_between(standard, issued_at)) or 0.0
    )


def name_left_out(standard: ReferenceStandard) -> Iterator[str]:
    """Yield what :func:`combine_standard` leaves out of a standard with a resolution, as not stated."""
    if standard.drift_a_year is None:
        yield f"drift of the {standard.role_words}"
    if standard.resolution is None:
        yield f"resolution of the {standard.role_words}"


def _years_between(standard: ReferenceStandard, issued_at: str) -> float:
    """Years from the date of a standard to that of a calibration."""
    used = datetime.fromisoformat(issued_at).date()
    return (used - date.fromisoformat(standard.date)).days / _DAYS_A_YEAR
