"""The force model of one sensor, learned from its own loads."""

from dataclasses import dataclass, fields, replace
from math import sqrt
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np

from cbsr_qa.calibration.force.template_matching import TemplateFilter
from cbsr_qa.calibration.force.templates import (
    LEAST_MISFIT,
    RESIDUE_SHARE,
    RESIDUE_STDERR,
    TemplateBank,
    make_even_model,
)
from cbsr_qa.calibration.sheet.baseline import predict_change
from cbsr_qa.calibration.sheet.response_map import LARGEST_ERROR, intercept_column, learn_response
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.domain.results.calibration import ForceModel
from cbsr_qa.domain.sensor.sensor_type import Parameter, QuasiStatic

if TYPE_CHECKING:
    from cbsr_qa.calibration.sheet.learned_map import LearnedMap

#: The predicted change must be this many of its own standard errors from zero, and so must the observed one.
_CLEAR: Final = 3.0
#: Median of a mean of two squared normals.
_MEDIAN: Final = 0.693
#: A frame has more than one head if a second one explains this many times more of it than the most in calibration
#: loads; templates of an uneven sheet leave a few parts in 10 000.
_MISFIT_ROOM: Final = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationLoads:
    """Loads at known places.

    Parameters
    ----------
    place_mm : (n, 2) places of the loads.
    rows : (n, r) mean steady rows of unit noise, against the rested sheet.
    frames : (n,) number, or equivalent number, of averaged frames.
    before : (n, r) mean rows just before the press; zero without frames.
    frames_before : (n,) number of frames, may be 0.
    force_N, force_stderr_N : (n,) forces and their standard errors.
    """

    place_mm: Array
    rows: Array
    frames: Indices | Array
    before: Array
    frames_before: Indices
    force_N: Array
    force_stderr_N: Array

    def select(self, which: Mask) -> "CalibrationLoads":
        return CalibrationLoads(*(getattr(self, column.name)[which] for column in fields(self)))

    def subtract_residues(self) -> tuple[Array, Array]:
        """Rows (n, r) without residues of earlier loads, and their noise variance (n,)."""
        before_mask = self.frames_before > 0
        share = np.where(before_mask, RESIDUE_SHARE, 0.0)
        noise = 1 / self.frames + share**2 / np.maximum(self.frames_before, 1)
        return self.rows - share[:, None] * self.before, noise


class MapLearner(Protocol):
    """Learns a map from single loads, as :func:`~cbsr_qa.calibration.sheet.response_map.learn_response` does."""

    def __call__(
        self,
        places_mm: Array,
        log_response: Array,
        variance: Array,
        *,
        radius_mm: float,
        bend: Array | None = None,
        bend_stderr: float = 1.0,
    ) -> "LearnedMap": ...


@dataclass(frozen=True, slots=True, eq=False)
class LearnedForce:
    """A force model with the data behind it.

    Parameters
    ----------
    line : α_σ and β_σ; their covariance is that of the intercept, turned about the calibrated stresses.
    response : the map, for any place.
    refused : (n,) reason for leaving a load out; empty if used.
    ratio, ratio_stderr : (n,) observed over predicted change, relative to the nominal response; NaN if left out.
    fitted_intercept : True if the loads determine the intercept.
    predicted : (n,) flags of the loads whose readings and force were predicted from a hold shorter than the run's
        longest.
    """

    model: ForceModel
    line: QuasiStatic
    response: "LearnedMap"
    refused: tuple[str, ...]
    ratio: Array
    ratio_stderr: Array
    fitted_intercept: bool
    predicted: tuple[bool, ...] = ()


def learn_force(
    bank: TemplateBank,
    merging: Array,
    loads: CalibrationLoads,
    line: QuasiStatic,
    head: Indenter,
    *,
    radius_mm: float,
    learn_map: MapLearner = learn_response,
) -> LearnedForce:
    """Learn a sensor's force model from loads at known places.

    Parameters
    ----------
    bank : templates of the head.
    merging : (r, m) [1/V] maps changes of used readings to rows.
    loads : loads of the calibration.
    line : α_σ and β_σ of the material, or of this sensor; deviations from it become part of the map.
    radius_mm : radius of the sheet.
    learn_map : what learns the map, with a prior of its own.

    Raises
    ------
    CalibrationError
        If fewer than three loads are usable; the message gives the reasons for the others.
    """
    make_uniform_model = make_even_model(bank, merging)
    filter_ = TemplateFilter(make_uniform_model)
    stress = loads.force_N / head.area_mm2 * 1e3
    matches = _match_loads(filter_, loads)
    predicted = line.slope.value * stress + line.intercept.value
    error = _relative_error(matches, loads, line, stress, predicted)
    refusals = _refusals(matches, predicted, line, stress, error)
    used_mask = np.array([not why for why in refusals])
    if int(used_mask.sum()) < 3:
        reasons = "; ".join(dict.fromkeys(why for why in refusals if why)) or "there are no others"
        raise CalibrationError(
            f"{int(used_mask.sum())} of {len(used_mask)} loads determine the response of the sheet; 3 are needed:"
            f" {reasons}"
        )
    ratio = np.full(len(used_mask), np.nan)
    ratio[used_mask] = matches.contrast[used_mask] / predicted[used_mask]
    bend, prior, middle = intercept_column(line, stress[used_mask], predicted[used_mask])
    response = learn_map(
        loads.place_mm[used_mask],
        np.log(ratio[used_mask]),
        error[used_mask] ** 2,
        radius_mm=radius_mm,
        bend=bend,
        bend_stderr=prior,
    )
    mean, variance = response.predict(bank.places_mm)
    fitted = _line(line, response.bend if bend is not None else (0.0, prior**2), middle, fitted=bend is not None)
    model = replace(
        make_uniform_model,
        log_response=mean,
        log_response_stderr=np.sqrt(variance),
        batch=response.batch,
        scatter=response.scatter,
        stress_kPa=(float(stress[used_mask].min()), float(stress[used_mask].max())),
        misfit=_MISFIT_ROOM * max(_second_share(filter_, loads, used_mask), LEAST_MISFIT),
        place_scatter_mm=_place_scatter_mm(filter_, loads, used_mask),
        residue_strength=_residue_strength(filter_, loads, used_mask),
    )
    return LearnedForce(
        model, fitted, response, refusals, ratio, np.where(used_mask, error * ratio, np.nan), bend is not None
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """Observation of loads: contrast κ and its standard error, detectability."""

    contrast: Array
    stderr: Array
    detectability: Array


def _match_loads(filter_: TemplateFilter, loads: CalibrationLoads) -> _Seen:
    rows, noise = loads.subtract_residues()
    matches = filter_.match_at(rows, loads.place_mm)
    strength = matches.strength
    residue = filter_.match_at(loads.before, loads.place_mm).strength
    variance = matches.covariance[:, 0, 0] * noise + (RESIDUE_STDERR * residue) ** 2
    return _Seen(
        2 * strength / (2 - strength),
        4 / (2 - strength) ** 2 * np.sqrt(variance),
        np.sqrt(matches.gain / noise),
    )


def _second_share(filter_: TemplateFilter, loads: CalibrationLoads, used: Mask) -> float:
    """Largest share of a single load's signal, as energy, that a second head explains, beyond noise."""
    rows, noise = loads.subtract_residues()
    matches = filter_.search(rows[used])
    second, _ = filter_.match_beside(rows[used], matches.place_mm, matches.strength)
    # Noise at the best of all places is below the threshold except for one frame in thousands.
    extra = np.maximum(second - noise[used] * filter_.threshold**2, 0.0)
    return float((extra / matches.gain).max())


def _place_scatter_mm(filter_: TemplateFilter, loads: CalibrationLoads, used: Mask) -> float:
    """Distance of found from pressed places, beyond noise; loads out of reach do not count."""
    rows, noise = loads.subtract_residues()
    matches = filter_.search(rows[used])
    error = ((matches.place_mm - loads.place_mm[used]) ** 2).mean(axis=1)
    expected = matches.covariance[:, [1, 2], [1, 2]].mean(axis=1) * noise[used]
    return float(np.sqrt(max(float(np.median(error - expected)) / _MEDIAN, 0.0)))


def _residue_strength(filter_: TemplateFilter, loads: CalibrationLoads, used: Mask) -> float:
    """Strength at the places of loads just before them, root mean square, less that of noise."""
    before_mask = used & (loads.frames_before > 0)
    if not before_mask.any():
        return 0.0
    residue = filter_.match_at(loads.before[before_mask], loads.place_mm[before_mask])
    squared = residue.strength**2 - residue.covariance[:, 0, 0] / loads.frames_before[before_mask]
    return float(np.sqrt(max(float(squared.mean()), 0.0)))


def _relative_error(
    seen: _Seen, loads: CalibrationLoads, line: QuasiStatic, stress: Array, predicted: Array
) -> Array:
    with np.errstate(divide="ignore", invalid="ignore"):
        of_force = line.slope.value * stress / predicted * loads.force_stderr_N / loads.force_N
        error: Array = np.hypot(seen.stderr / seen.contrast, of_force)
    return np.where(np.isfinite(error), error, np.inf)


def _refusals(seen: _Seen, predicted: Array, line: QuasiStatic, stress: Array, error: Array) -> tuple[str, ...]:
    unclear = [
        abs(p) < _CLEAR * predict_change(line, at)[1] for p, at in zip(predicted, stress.tolist(), strict=True)
    ]
    reasons = []
    for number in range(len(predicted)):
        if not np.isfinite(seen.contrast[number]):
            reasons.append("the place is outside what can be calibrated")
        elif not stress[number] > 0:
            reasons.append("no force was measured")
        elif predicted[number] == 0 or unclear[number]:
            reasons.append(f"α σ + β = {predicted[number]:.3g} at {stress[number]:.3g} kPa is not clear of zero")
        elif seen.detectability[number] < _CLEAR:
            reasons.append("the load does not stand out of the noise of the readings")
        elif seen.contrast[number] * predicted[number] < 0:
            reasons.append("it changed in the direction opposite to the material's response")
        elif error[number] > LARGEST_ERROR:
            reasons.append(f"the standard error of its amplitude is {error[number]:.0%}")
        else:
            reasons.append("")
    return tuple(reasons)


def _line(line: QuasiStatic, bend: tuple[float, float], middle: float, *, fitted: bool) -> QuasiStatic:
    """The line with another intercept, turned about the change in the middle, which the map preserves.

    Without a standard error where the intercept was not fitted and the material states none.
    """
    change, variance = bend
    alpha, beta = line.slope.value, line.intercept.value
    by_slope, by_intercept = -alpha / middle, 1 - beta / middle
    source = (
        "fitted to this sensor's loads" if fitted else "assumed: all loads of the calibration have the same force"
    )
    if not fitted and line.intercept.stderr is None:
        return QuasiStatic(Parameter(alpha, None, line.slope.source), Parameter(beta, None, source))
    return QuasiStatic(
        slope=Parameter(alpha + by_slope * change, abs(by_slope) * sqrt(variance), line.slope.source),
        intercept=Parameter(beta + by_intercept * change, abs(by_intercept) * sqrt(variance), source),
        covariance=by_slope * by_intercept * variance,
    )
