"""Quality of a sensor's force: held-out errors, response map, detection limit."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cbsr_qa.analysis.run.force import HELD_OUT, ForceTest, RunForce
from cbsr_qa.analysis.run.loads import window_of
from cbsr_qa.calibration.fits.common_relaxation import TimedValues, fit_common_relaxation
from cbsr_qa.calibration.fits.estimates import Estimate
from cbsr_qa.calibration.force.interpolation import interpolate
from cbsr_qa.calibration.force.inverse import ForceInverse, map_tables
from cbsr_qa.calibration.force.learning import LearnedForce
from cbsr_qa.calibration.force.template_matching import Matches, TemplateFilter
from cbsr_qa.calibration.sheet.characteristic import sheet_gauge_factor, steady_share
from cbsr_qa.calibration.sheet.response_map import sheet_places
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.steps import Role
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.domain.results.observation import LoadObservation, RunObservation

#: Fewest errors for a standard deviation.
FEWEST: Final = 2
#: Fewest loads for which the share inside an interval tells a correct one from one half as wide: its own
#: standard deviation is then 9 %.
FEWEST_COVERED: Final = 30
#: Relative error of the correction to the steady state, unknown to the common fit: residues of earlier loads bend the
#: slow exponential. Root mean square over 12 simulated sensors whose residue is 3 % and decays in 300 s.
_OF_RESIDUES: Final = 0.12


@dataclass(frozen=True, slots=True, eq=False)
class ForceErrors:
    """Errors of the loads of one test.

    Parameters
    ----------
    tests : those with an estimate; ``missed`` more have none.
    error_N, stderr_N : (n,) estimated minus measured, and its stated error including the load cell's.
    """

    tests: tuple[ForceTest, ...]
    missed: int
    error_N: Array
    stderr_N: Array

    def deviation(self) -> Estimate:
        """Return the standard deviation [N] and its own standard error.

        The standard error allows for the sample's kurtosis, at least a normal one's: heavy loads err more than light
        ones.
        """
        count = self._count_errors()
        centred_N = self.error_N - self.error_N.mean()
        second = float((centred_N**2).mean())
        if second == 0:
            return Estimate(0.0, None, count - 1)
        kurtosis = max(float((centred_N**4).mean()) / second**2, 3.0)
        value = float(np.sqrt(second * count / (count - 1)))
        return Estimate(
            value, value * float(np.sqrt((kurtosis - (count - 3) / (count - 1)) / (4 * count))), count - 1
        )

    def bias(self) -> Estimate:
        """Return the mean error [N] and its standard error.

        Raise NumericsError if there are fewer than two loads.
        """
        count = self._count_errors()
        spread = float(self.error_N.std(ddof=1))
        return Estimate(float(self.error_N.mean()), spread / count**0.5 or None, count - 1)

    def inside(self, reach: float) -> int:
        """Return how many loads err by at most this many stated standard errors."""
        return int((np.abs(self.error_N) <= reach * self.stderr_N).sum())

    def coverage(self, reach: float, nominal: float) -> Estimate:
        """Return the share of loads within this many stated standard errors, and the scatter of a nominal share."""
        count = len(self.error_N)
        if count < FEWEST_COVERED:
            raise NumericsError(f"{self.inside(reach)} of {count} loads; a share needs at least {FEWEST_COVERED}")
        return Estimate(self.inside(reach) / count, float(np.sqrt(nominal * (1 - nominal) / count)), count)

    def _count_errors(self) -> int:
        count = len(self.error_N)
        if count < FEWEST:
            raise NumericsError(
                f"{count or 'no'} {'load' if count == 1 else 'loads'} with an estimate: two are needed"
            )
        return count


def tests_of(run: RunObservation, force: RunForce, how: str) -> tuple[ForceTest, ...]:
    """Return the tests of one kind.

    Held-out loads come from phases that press all over the sheet, if there are any: repeated presses at one place
    (noise figure, relaxation) do not represent the sheet.
    """
    tests = tuple(test for test in force.tests if test.how == how)
    spread = {phase.name for phase in run.record.phases if phase.role in (Role.GRID, Role.RANDOM)}
    sample = tuple(test for test in tests if test.load.phase in spread)
    return sample if sample and how == HELD_OUT else tests


def errors_of(tests: Sequence[ForceTest], *, known: bool) -> ForceErrors:
    """Return the errors with the place given, or estimated."""
    estimated = tuple(test for test in tests if known or test.found_N is not None)
    if known:
        estimate = np.array([test.known_N for test in estimated])
        stated = np.array([test.known_stderr_N for test in estimated])
    else:
        estimate = np.array([test.found_N or 0.0 for test in estimated])
        errors = [(test.found_stderr_N or 0.0, test.load.force_stderr_N or 0.0) for test in estimated]
        stated = np.array([float(np.hypot(found_N, measured_N)) for found_N, measured_N in errors])
    measured = np.array([test.measured_N for test in estimated])
    return ForceErrors(estimated, len(tests) - len(estimated), estimate - measured, stated)


def global_errors(tests: Sequence[ForceTest]) -> ForceErrors:
    """Return the errors with the place given and one response for the whole sheet, which has no stated error."""
    error = np.array([test.global_N - test.measured_N for test in tests])
    return ForceErrors(tuple(tests), 0, error, np.full(len(tests), np.inf))


def calibration_radius_mm(force: RunForce) -> float:
    """Return the distance of the farthest calibration load from the centre [mm]."""
    assert force.learned is not None
    places = places_mm([load for load, refusal in zip(force.used, force.learned.refused, strict=True) if not refusal])
    return float(np.hypot(*places.T).max())


def places_mm(loads: Sequence[LoadObservation]) -> Array:
    """Return the places of loads, (n, 2)."""
    return np.array([load.place_mm for load in loads]).reshape(-1, 2)


@dataclass(frozen=True, slots=True, eq=False)
class MapQuality:
    """The map at the places of the calibrated area.

    Parameters
    ----------
    places_mm, response, stderr : (n, 2), (n,) S and (n,) its relative standard error.
    spread : standard deviation of the sheet's response over its mean: the map's, and unresolved variation.
    rms_error : root mean square of ``stderr``.
    least_sure_mm : place where ``stderr`` is largest [mm].
    """

    places_mm: Array
    response: Array
    stderr: Array
    spread: float
    rms_error: float
    least_sure_mm: tuple[float, float]


def map_quality(learned: LearnedForce, radius_mm: float) -> MapQuality:
    """Restrict the map to a radius; at least to the place nearest to the centre."""
    places = sheet_places(learned.model, stride=1)
    away = np.hypot(*places.T)
    places = places[away <= max(radius_mm, float(away.min())) + 1e-9]
    values = interpolate(learned.model, learned.model.log_response, places)
    stderr = interpolate(learned.model, learned.model.log_response_stderr, places)
    response = np.exp(values)
    mapped = float(response.std() / response.mean())
    x_mm, y_mm = places[int(stderr.argmax())]
    rms = float(np.sqrt((stderr**2).mean()))
    return MapQuality(places, response, stderr, float(np.hypot(mapped, rms)), rms, (float(x_mm), float(y_mm)))


@dataclass(frozen=True, slots=True)
class Detectable:
    """Detection limit in one frame, its place, and the error of that force [N]."""

    force_N: float
    stderr_N: float
    place_mm: tuple[float, float]


def detectable_forces(learned: LearnedForce, head: Indenter, places_mm: Array) -> tuple[Detectable, ...]:
    """Return the force of the detection threshold at places (n, 2): half of such loads are detected.

    Raise NumericsError if by the line no load would be detected.
    """
    model = learned.model
    template = TemplateFilter(model).template(places_mm)
    sign = np.sign(learned.line.slope.value)
    strength = sign * model.threshold / np.linalg.norm(template, axis=1)
    nothing = np.zeros(len(places_mm))
    matches = Matches(places_mm, strength, np.zeros((len(places_mm), 3, 3)), nothing, nothing)
    force, stderr = ForceInverse(model, learned.line, head.area_mm2, map_tables(model)).force(matches)
    if not (np.isfinite(force).all() and (force > 0).all()):
        raise NumericsError("the line's intercept alone exceeds the threshold: there is no least force")
    places = (tuple(map(float, place)) for place in places_mm)
    return tuple(Detectable(float(f), float(e), (p[0], p[1])) for f, e, p in zip(force, stderr, places, strict=True))


def gauge_factor(
    run: RunObservation, force: RunForce, *, traces: Sequence[TimedValues] | None = None
) -> tuple[Estimate, Estimate]:
    """Return the gauge factor of the sheet, and the ratio of steady to observed values.

    Parameters
    ----------
    traces : traces of holds, which determine how the conductance approaches its steady state; by default those of the
        run's blobs.

    Raises
    ------
    CbsrError
        If strains, loads or relaxations do not determine it, with the reason.
    """
    learned = force.learned
    assert learned is not None
    usable_indices = [
        k for k, load in enumerate(force.used) if np.isfinite(learned.ratio[k]) and load.record.load.strain > 0
    ]
    loads = [force.used[k] for k in usable_indices]
    if not loads:
        raise NumericsError("no load of the calibration has a nominal strain")
    line = run.record.material.against_stress
    stress = np.array([load.stress_kPa or 0.0 for load in loads])
    contrast = learned.ratio[usable_indices] * (line.slope.value * stress + line.intercept.value)
    fitted_factor = sheet_gauge_factor(
        places_mm(loads),
        contrast,
        (learned.ratio_stderr[usable_indices] / learned.ratio[usable_indices]) ** 2,
        np.array([load.record.load.strain for load in loads]),
        run.record.material.against_strain,
        radius_mm=run.record.sensor_type.radius_mm,
        sheet_mm=sheet_places(learned.model),
    )
    if traces is None:
        traces = _blob_traces(run)
    share = _steady_share(run, loads, traces, learned.model.steady_s)
    value = fitted_factor.value * share.value
    relative = float(
        np.hypot((fitted_factor.stderr or 0.0) / fitted_factor.value, (share.stderr or 0.0) / share.value)
    )
    return Estimate(value, abs(value) * relative, fitted_factor.degrees), share


def _blob_traces(run: RunObservation) -> list[TimedValues]:
    return [
        (relaxation.trace.time_s, relaxation.trace.values)
        for load in run.loads
        for relaxation in load.relaxations
        if relaxation.signal == "conductance" and relaxation.loading
    ]


def _steady_share(
    run: RunObservation, loads: Sequence[LoadObservation], traces: Sequence[TimedValues], predicted_s: float
) -> Estimate:
    """Steady share of the averaged frames, equal for all loads with equal or predicted holds."""
    times = [window_of(run, load).steady.time_s - load.record.hold_start_s for load in loads]
    if run.settings.transients == "predicted" and predicted_s > 0:
        times = [np.array([predicted_s])]
    fitted_share = steady_share(fit_common_relaxation(traces), np.concatenate(times))
    of_residues = _OF_RESIDUES * abs(fitted_share.value - 1)
    return Estimate(
        fitted_share.value, float(np.hypot(fitted_share.stderr or 0.0, of_residues)), fitted_share.degrees
    )
