"""Sensed change against stress, strain by strain, of each location; gauge factor of the whole sheet."""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cbsr_qa.calibration.fits.common_relaxation import CommonRelaxation
from cbsr_qa.calibration.fits.estimates import Estimate, pool_deviations
from cbsr_qa.calibration.sheet.baseline import measure_sensed_change
from cbsr_qa.calibration.sheet.response_map import average_response, intercept_column, learn_response
from cbsr_qa.domain.errors import CalibrationError, NumericsError
from cbsr_qa.domain.numbers import Array, Indices
from cbsr_qa.domain.plan.steps import Role
from cbsr_qa.domain.results.observation import LoadObservation, RunObservation
from cbsr_qa.domain.sensor.sensor_type import QuasiStatic


def sheet_gauge_factor(
    places_mm: Array,
    contrast: Array,
    relative_variance: Array,
    strain: Array,
    line: QuasiStatic,
    *,
    radius_mm: float,
    sheet_mm: Array,
) -> Estimate:
    """Estimate the mean over a sheet of the local gauge factor, α_ε times the relative response of each place.

    κ = S (α_ε ε + β_ε) (paper Eqs 1 and 7, against strain): ln S is learned as in
    ``learn_response``, where strains differ together with an error of β_ε.

    Parameters
    ----------
    places_mm, contrast, relative_variance, strain : (n, 2), (n,), (n,), (n,) of loads, contrast with the sign of α_ε.
    line : nominal α_ε and β_ε; only β_ε remains an assumption, and only for equal strains.
    radius_mm : radius of the sheet.
    sheet_mm : (m, 2) places to average over, see :func:`~cbsr_qa.calibration.sheet.response_map.sheet_places`.

    Raises
    ------
    CalibrationError
        If there are fewer than 3 loads, or the line predicts no change, or one of the other sign, for one of them.
    """
    predicted = line.slope.value * strain + line.intercept.value
    if not ((predicted * contrast) > 0).all():
        raise CalibrationError(
            f"the line {line.slope.value:.3g} ε {line.intercept.value:+.3g} predicts no change of the sign seen"
            f" at {int((predicted * contrast <= 0).sum())} of {len(strain)} loads: they say nothing about a response",
            remedy="press harder, where α ε + β is clear of zero",
        )
    bend, bend_stderr, middle = intercept_column(line, strain, predicted)
    response = learn_response(
        places_mm,
        np.log(contrast / predicted),
        relative_variance,
        radius_mm=radius_mm,
        bend=bend,
        bend_stderr=bend_stderr,
    )
    change, variance = response.bend
    slope = line.slope.value * (1 - change / middle)
    log_mean, log_variance = average_response(response, sheet_mm)
    pointwise, _ = response.predict(sheet_mm)
    shape = float(np.exp(pointwise - log_mean).mean())  # a mean of responses, not of their logarithms
    value = slope * float(np.exp(log_mean)) * shape
    turned = line.slope.value / middle / slope
    return Estimate(value, abs(value) * float(np.sqrt(log_variance + turned**2 * variance)), len(strain) - 1)


def steady_share(common: CommonRelaxation, time_s: Array) -> Estimate:
    """Estimate the end of a hold relative to frames at times (n,) after its ramp, from the loads' relaxation.

    NumericsError if the traces show no complete relaxation, or it ends where it began.
    """
    fit = common.fit
    if not len(common.shares):
        raise NumericsError(f"it is not known where holds end: {fit.why}", remedy="hold longer")
    count = len(fit.amplitudes)
    start = np.concatenate([[fit.offset], fit.amplitudes, np.log(fit.time_constants_s)])

    def share(values: Array) -> float:
        decays = np.exp(-np.asarray(time_s)[:, None] / np.exp(values[1 + count :]))
        return float(values[0] / (values[0] + (decays @ values[1 : 1 + count]).mean()))

    value = share(start)
    if not np.isfinite(value) or value <= 0:
        raise NumericsError("it is not known where holds end: the change they end at is about zero")
    steps = 0.01 * np.sqrt(np.diag(common.covariance))
    gradient = np.array(
        [
            0.0 if step == 0 else (share(start + step * unit) - share(start - step * unit)) / (2 * step)
            for step, unit in zip(steps, np.eye(len(start)), strict=True)
        ]
    )
    return Estimate(value, float(np.sqrt(max(gradient @ common.covariance @ gradient, 0.0))), common.traces)


#: Phases used for a data sheet: nominal places and strains, equal holds.
_ROLES: Final = frozenset({Role.GRID, Role.NOISE})


@dataclass(frozen=True, slots=True, eq=False)
class Characteristic:
    """Response of a location to each strain, averaged over its trials.

    Parameters
    ----------
    location, x_mm, y_mm : name and place of the loads; ``"mean"`` and the sheet's centre for a mean over locations.
    strain : (n,) float64 fractions, rising.
    stress_kPa : (n,) float64 mean relaxed stress under the head; None without recorded force.
    change : (n,) float64 mean sensed change, relative, positive.
    loads : (n,) number of presses in each mean.
    """

    location: str
    x_mm: float
    y_mm: float
    strain: Array
    stress_kPa: Array | None
    change: Array
    loads: Indices

    @property
    def span(self) -> float:
        """Output at the highest strain; the lower range value is the unloaded sheet, zero by its reference."""
        return float(self.change[-1])


def data_sheet_loads(run: RunObservation) -> tuple[LoadObservation, ...]:
    """Loads for a data sheet: single ones of the phases that press nominal places and strains."""
    phases = {phase.name for phase in run.record.phases if phase.role in _ROLES}
    return tuple(load for load in run.loads if load.phase in phases and load.together == 1)


def why_no_force(loads: Iterable[LoadObservation]) -> str:
    """Explain why none of some loads has a force."""
    return next((load.no_force for load in loads if load.no_force), "no force was recorded")


def load_change(load: LoadObservation, main_mask: float) -> float | None:
    """Sensed change of a load's steady image: Δρ of Eq 7, un-subtracted, positive; None if nothing was sensed."""
    view = load.mask(main_mask)
    if view is None or view.sensed is None:
        return None
    return float(measure_sensed_change(load.image.values, view.sensed, load.response))


def characteristics(loads: Iterable[LoadObservation], main_mask: float) -> tuple[Characteristic, ...]:
    """Average the loads of each location strain by strain, in the order of their first press.

    Loads without a sensed region are left out, and if any load has a force, also those without (a load cell at its
    limit); without any force there are no stresses.
    """
    loads = tuple(loads)
    loads = tuple(load for load in loads if load.stress_kPa is not None) or loads
    places: dict[tuple[str, float, float], list[tuple[LoadObservation, float]]] = defaultdict(list)
    for load in loads:
        change, nominal = load_change(load, main_mask), load.record.load
        if change is not None:
            places[(nominal.label, nominal.x_mm, nominal.y_mm)].append((load, change))
    return tuple(_characteristic(place, members) for place, members in places.items())


def mean_characteristic(curves: Sequence[Characteristic]) -> Characteristic:
    """Average over the locations pressed at the largest common set of strains.

    Each location's change is relative to its own span, so that the mean's span is 1: equal changes have stronger
    images where the electrodes are more sensitive.

    NumericsError if there is no such location with a positive span.
    """
    fullest = max((curve.strain for curve in curves), key=len, default=np.empty(0))
    common_curves = [
        c for c in curves if len(c.strain) == len(fullest) and np.allclose(c.strain, fullest) and c.span > 0
    ]
    if not common_curves:
        raise NumericsError("nothing was sensed at any location")
    stresses = [c.stress_kPa for c in common_curves if c.stress_kPa is not None]
    return Characteristic(
        "mean",
        0.0,
        0.0,
        fullest,
        np.mean(stresses, axis=0) if len(stresses) == len(common_curves) else None,
        np.mean([c.change / c.span for c in common_curves], axis=0),
        np.sum([c.loads for c in common_curves], axis=0),
    )


def collect_repeated_changes(loads: Sequence[LoadObservation], main_mask: float) -> dict[float, list[list[float]]]:
    """Sensed changes of repeatedly pressed places, by strain: the cells of repeatability.

    A cell is a phase, place and strain. Its values are relative to the place's own span, its mean change at the
    highest strain of all these loads; places not pressed at that strain and single presses are left out.
    """
    highest = max((round(load.record.load.strain, 9) for load in loads), default=0.0)
    spans: dict[tuple[float, float], list[float]] = defaultdict(list)
    cells: dict[float, dict[tuple[str, float, float], list[float]]] = defaultdict(lambda: defaultdict(list))
    for load in loads:
        change, nominal_load = load_change(load, main_mask), load.record.load
        if change is None:
            continue
        cells[round(nominal_load.strain, 9)][(load.phase, nominal_load.x_mm, nominal_load.y_mm)].append(change)
        if round(nominal_load.strain, 9) == highest:
            spans[(nominal_load.x_mm, nominal_load.y_mm)].append(change)
    mean = {place: float(np.mean(changes)) for place, changes in spans.items() if np.mean(changes) > 0}
    repeated = {
        strain: [
            [value / mean[place] for value in values]
            for (_, *position), values in by_place.items()
            if (place := (position[0], position[1])) in mean and len(values) > 1
        ]
        for strain, by_place in sorted(cells.items())
    }
    return {strain: values for strain, values in repeated.items() if values}


def repeatability(loads: Sequence[LoadObservation], main_mask: float) -> Estimate:
    """Pooled deviation of the sensed change within phase, place and strain, relative to the place's span.

    NumericsError if nothing was pressed twice at the same place and strain.
    """
    by_strain = collect_repeated_changes(loads, main_mask)
    return pool_deviations([cell for cells in by_strain.values() for cell in cells])


def _characteristic(
    place: tuple[str, float, float], members: Sequence[tuple[LoadObservation, float]]
) -> Characteristic:
    strain = np.array([round(load.record.load.strain, 9) for load, _ in members])
    change = np.array([value for _, value in members])
    levels, level_index, counts = np.unique(strain, return_inverse=True, return_counts=True)
    stresses = [load.stress_kPa for load, _ in members]
    known_stresses = [stress for stress in stresses if stress is not None]
    return Characteristic(
        *place,
        levels,
        np.bincount(level_index, known_stresses) / counts if len(known_stresses) == len(stresses) else None,
        np.bincount(level_index, change) / counts,
        counts.astype(np.int64),
    )
