"""Load estimates from the readings of a run, independent of its images."""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.analysis.defects.quality import subtract_trend
from cbsr_qa.analysis.run.loads import LoadWindow, window_of
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.readings.frames import FrameBlock
from cbsr_qa.domain.readings.load_estimates import LoadEstimate
from cbsr_qa.domain.results.observation import LoadObservation, RunObservation
from cbsr_qa.eit.estimate.load_estimate import LoadEstimator
from cbsr_qa.eit.estimate.readings import MergedReadings, load_model, merge_reciprocal
from cbsr_qa.eit.loads.round_load import RoundLoadModel

Key = tuple[str, int]  # phase, index of the load within it

#: Fewest unloaded frames for which the noise of a single reading is known.
FEWEST_FRAMES: Final = 6
#: Noise variance relative to the median below which a reading is quantised rather than quiet.
_QUIETEST: Final = 1e-2


@dataclass(frozen=True, slots=True, eq=False)
class EstimatedLoad:
    """Estimate of one press from its readings.

    Parameters
    ----------
    indenter : estimate with the radius of the head given; None if the head is not round, or the estimate failed.
    size : estimate with an unknown radius; None if the estimate failed.
    why : reason of a failed estimate; empty otherwise.
    """

    indenter: LoadEstimate | None
    size: LoadEstimate | None
    why: str = ""


def estimate_loads(run: RunObservation, reference: str) -> Mapping[Key, EstimatedLoad]:
    """Return an estimate of every load of a run; it is cached with the run.

    Parameters
    ----------
    reference : ``"run"`` or ``"load"``: what changes are relative to, as in the recipe's settings.

    Returns
    -------
    Estimates by phase and by index of the load within it.
    """
    return run.derive(_estimate_loads, reference)


def _estimate_loads(run: RunObservation, reference: str) -> Mapping[Key, EstimatedLoad]:
    single_loads = [load for load in run.loads if load.together == 1]
    try:
        model = load_model(run.record.sensor_type)
        noise = reading_variance(run.unloaded, run.usable)
        estimates = _estimates(run, single_loads, model, noise, reference) if single_loads else {}
    except NumericsError as error:
        return {_key(load): EstimatedLoad(None, None, error.reason) for load in run.loads}
    several_held = "{} loads were held at once; the estimate needs one"
    refusals = {
        _key(load): EstimatedLoad(None, None, several_held.format(load.together))
        for load in run.loads
        if load.together > 1
    }
    return {**estimates, **refusals}


def reading_variance(unloaded: FrameBlock, usable: NDArray[np.bool_]) -> Array:
    """Noise variance of every reading of one frame, (drives, measures) [V²], about a straight line in time.

    The variance is raised by ν/(ν − 2) for ν degrees of freedom: misfits weighted by its inverse average one.

    The moderated variances used for images (:mod:`cbsr_qa.eit.inverse.readings`) are the better estimate: from 16
    unloaded frames they make force errors 6 % smaller (39 places, 6 sensors of 30 held-out loads: 0.059 to 0.055 N
    with the place known, 0.070 to 0.065 N with it estimated). But the stated errors hardly follow (68 % intervals
    contain 75 and 74 % of the loads, now 73 and 72 %), and the allowances for residues and places were determined
    with these variances.

    Raise NumericsError if there are too few frames, or they do not differ.
    """
    count = len(unloaded)
    if count < FEWEST_FRAMES:
        raise NumericsError(f"{count} unloaded frames are too few to estimate noise; {FEWEST_FRAMES} are needed")
    readings_by_frame = unloaded.voltages.reshape(count, -1)
    residuals = subtract_trend(readings_by_frame, unloaded.time_s)
    freedom = count - 2
    variance = ((residuals**2).sum(axis=0) / freedom).reshape(usable.shape) * freedom / (freedom - 2)
    typical = float(np.median(variance[usable]))
    # Rounding of identical frames is not noise.
    if typical <= (1e-13 * np.abs(readings_by_frame).max()) ** 2:
        raise NumericsError("the unloaded frames do not differ: there is no noise to weight readings by")
    quiet: Array = np.maximum(variance, _QUIETEST * typical)
    return quiet


def _key(load: LoadObservation) -> Key:
    return load.phase, load.record.index


def _estimates(
    run: RunObservation, loads: list[LoadObservation], model: RoundLoadModel, noise: Array, reference: str
) -> dict[Key, EstimatedLoad]:
    """Estimate loads in groups of equal noise: equal numbers of frames under the hold and for the reference."""
    groups: dict[tuple[int, int], list[tuple[LoadObservation, LoadWindow]]] = defaultdict(list)
    for load in loads:
        window = window_of(run, load)
        has_own_reference = reference == "load" and len(window.before) > 0
        count = len(window.before) if has_own_reference else len(run.unloaded) - run.settings.noise_floor_frames
        groups[(len(window.steady), count if has_own_reference else -count)].append((load, window))
    estimates: dict[Key, EstimatedLoad] = {}
    scale = model_scale(model, run.reference, run.usable)
    for (steady, signed), members in groups.items():
        variance = noise * (1 / steady + 1 / abs(signed)) / scale**2
        readings = merge_reciprocal(run.record.sensor_type.pattern, run.usable, variance)
        changes = np.stack(
            [
                window.steady.voltages.mean(axis=0)
                - (window.before.voltages.mean(axis=0) if signed > 0 else run.reference)
                for _, window in members
            ]
        )
        estimates |= _group(run, [load for load, _ in members], model, readings, changes[:, run.usable] / scale)
    return estimates


def _group(
    run: RunObservation,
    loads: list[LoadObservation],
    model: RoundLoadModel,
    readings: MergedReadings,
    changes: Array,
) -> dict[Key, EstimatedLoad]:
    head = run.record.indenter
    start = np.array([_start(load, run.main_mask) for load in loads])
    size = LoadEstimator(model, readings, expected_radius_mm=head.radius_mm, known=False)
    sized = size.estimate(changes, start_mm=start)
    estimates_of_known_size: tuple[LoadEstimate | None, ...] = (None,) * len(loads)
    if not head.outline_mm:
        estimator = LoadEstimator(model, readings, expected_radius_mm=head.radius_mm, known=True)
        estimates_of_known_size = estimator.estimate(changes, start_mm=start)
    pairs = zip(loads, estimates_of_known_size, sized, strict=True)
    return {_key(load): EstimatedLoad(with_head, other) for load, with_head, other in pairs}


def model_scale(model: RoundLoadModel, reference: Array, usable: NDArray[np.bool_]) -> float:
    """Scale of a sensor against the model of unit conductance: a least-squares fit of its reference frame [A/S].

    Raise NumericsError if the frame has nothing in common with the model's.
    """
    expected, readings = model.solve_unloaded()[usable], reference[usable]
    scale = float(readings @ expected / (expected @ expected))
    if abs(scale) * np.linalg.norm(expected) <= 1e-6 * np.linalg.norm(readings) or scale == 0:
        raise NumericsError("the reference frame is uncorrelated with the model's")
    return scale


def _start(load: LoadObservation, mask: float) -> tuple[float, float]:
    """Centre of mass of the sensed blob; otherwise the sheet's centre, from where the search finds its own."""
    view = load.mask(mask)
    if view is None or view.sensed is None:
        return 0.0, 0.0
    x_mm, y_mm = view.sensed.centre_mm()
    return float(x_mm), float(y_mm)
