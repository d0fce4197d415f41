"""How many presses a phase that decides will make, before anything is measured.

They are those of a usual sheet or, with a batch's model as prior, of a usual sensor of the batch.
"""

from dataclasses import dataclass
from itertools import islice
from typing import Final

import numpy as np
from scipy.special import gammaincinv

from cbsr_qa.calibration.force.expected_error import LoadErrors, predict_error_bound
from cbsr_qa.calibration.force.interpolation import interpolate
from cbsr_qa.calibration.force.templates import make_even_model, template_bank
from cbsr_qa.calibration.sheet.usual_sheet import USUAL_SCATTER, choose_presses, order_presses
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.analysis_settings import AnalysisSettings
from cbsr_qa.domain.plan.steps import Press
from cbsr_qa.eit.estimate.readings import load_model, merge_reciprocal
from cbsr_qa.station.decisions import Choice, PressDecisions
from cbsr_qa.station.plan import Plan, schedule

#: Relative error that forces after predicted holds share: standard deviation of twenty simulated sensors.
_SHARED: Final = 0.015
#: Independent errors that the mean over the loads that matter has on a usual sheet.
_FREEDOM: Final = 8.0


@dataclass(frozen=True, slots=True)
class PressForecast:
    """Presses of a phase that decides, and the force error without a map's.

    Parameters
    ----------
    least, expected, most : numbers of presses; the most is expected if a usual sheet does not reach the target.
    noise_N, floor_N : force error by the noise of readings alone, and with what single loads scatter and share.
    reached : whether a usual sheet reaches the target.
    batch_model : digest of the batch's model that says what is usual; empty without one.
    """

    phase: int
    least: int
    expected: int
    most: int
    noise_N: float
    floor_N: float
    reached: bool
    batch_model: str = ""


def forecast_presses(decisions: PressDecisions, plan: Plan, settings: AnalysisSettings) -> tuple[PressForecast, ...]:
    """Forecast the presses of every phase that decides.

    Raises
    ------
    ConfigError
        If the noise of the readings alone makes a larger error than the target.
    """
    return tuple(_forecast(plan, settings, phase, choice) for phase, choice in decisions.choices.items())


def _forecast(plan: Plan, settings: AnalysisSettings, phase: int, choice: Choice) -> PressForecast:
    goal, material, head = choice.goal, plan.material, plan.indenter
    places_mm = choice.matter.places_mm()
    noise_N = _noise_N(plan, places_mm, settings.steady_frames)
    if noise_N >= goal.target_N:
        raise ConfigError(
            f"phase {plan.phases[phase].name!r}: target_N is {goal.target_N:g}, and the noise of the readings alone"
            f" makes an error of {noise_N:.2g} N",
            remedy=f"raise target_N well above {noise_N:.2g}, or average more frames (analysis.steady_frames)",
        )
    per_strain_N = material.modulus_kPa.value * 1e-3 * head.area_mm2
    shared = _SHARED if settings.transients == "predicted" else 0.0
    single = LoadErrors(choice.matter.lever_N(per_strain_N, material.against_stress, head), noise_N, shared)
    pressed_mm = _list_pressed_mm(plan, settings, phase)
    if settings.batch is None:
        errors_N, scatter = _expect_usual(plan, choice, places_mm, pressed_mm, single), USUAL_SCATTER
    else:
        errors_N, scatter = _expect_by_batch(plan, settings, choice, places_mm, pressed_mm, single)
    enough = np.flatnonzero(errors_N <= goal.target_N) + 1
    expected = max(int(enough[0]), goal.at_least) if len(enough) else goal.at_most
    floor_N = float(np.hypot(noise_N, single.lever_N * np.hypot(shared, scatter)))
    return PressForecast(
        phase,
        goal.at_least,
        expected,
        goal.at_most,
        noise_N,
        floor_N,
        len(enough) > 0,
        "" if settings.batch is None else settings.batch.digest,
    )


def _expect_usual(plan: Plan, choice: Choice, places_mm: Array, pressed_mm: Array, single: LoadErrors) -> Array:
    """Upper bounds (n,) of the force error of a usual sheet after each press up to the most [N]."""
    goal = choice.goal
    _, left = order_presses(
        choice.places_mm(list(choice.loads)),
        places_mm,
        goal.at_most,
        pressed_mm=pressed_mm,
        radius_mm=plan.sensor_type.radius_mm,
    )
    bound = gammaincinv(_FREEDOM / 2, goal.confidence) / (_FREEDOM / 2)
    relative = np.sqrt(bound * (left + single.shared**2) + USUAL_SCATTER**2)
    errors_N: Array = np.hypot(single.noise_N, single.lever_N * relative)
    return errors_N


def _expect_by_batch(
    plan: Plan, settings: AnalysisSettings, choice: Choice, places_mm: Array, pressed_mm: Array, single: LoadErrors
) -> tuple[Array, float]:
    """Upper bounds (n,) of the force error by the batch's model after each press [N], and the scatter of loads.

    Presses are those of the run's decisions but for their travel: first those of a usual sheet, then where the model
    expects most of them. Each is as sure as the batch's.
    """
    from cbsr_qa.analysis.run.batch_prior import choose_batch_prior  # loads what few recipes need

    goal, candidates_mm = choice.goal, choice.places_mm(list(choice.loads))
    n, end = len(candidates_mm), len(candidates_mm) + len(places_mm)
    every_mm = np.vstack([candidates_mm, places_mm, pressed_mm.reshape(-1, 2)])
    weights, scatter, covariances = choose_batch_prior(settings)[0].prior.covary(every_mm)
    assert settings.batch is not None
    press_variance = float(np.median(np.concatenate([sensor.variance for sensor in settings.batch.sensors])))
    first, _ = order_presses(
        candidates_mm, places_mm, goal.at_least, pressed_mm=pressed_mm, radius_mm=plan.sensor_type.radius_mm
    )
    presses = choose_presses(
        covariances,
        weights,
        scatter + press_variance,
        np.arange(n),
        np.arange(n, end),
        pressed=range(end, len(every_mm)),
        first=first,
    )
    usual_scatter = float(np.sqrt(weights @ scatter))
    errors_N = [
        predict_error_bound(after, weights, usual_scatter, single, goal.confidence)
        for _, after in islice(presses, goal.at_most)
    ]
    return np.array(errors_N), usual_scatter


def _noise_N(plan: Plan, places_mm: Array, frames: int) -> float:
    """Error of force by the noise of readings that the material states, root mean square over places (t, 2) [N]."""
    sensor_type, material = plan.sensor_type, plan.material
    model, used = load_model(sensor_type), sensor_type.pattern.usable()
    level = float(np.abs(model.solve_unloaded()[used]).mean())
    variance = np.full(sensor_type.pattern.shape, (material.relative_noise.value * level) ** 2)
    readings = merge_reciprocal(sensor_type.pattern, used, variance)
    even = make_even_model(template_bank(model, readings, plan.indenter), readings.merging)
    strength = np.exp(-interpolate(even, even.log_size, places_mm)) / np.sqrt(frames)
    stress_kPa = np.sqrt(np.mean(strength**2)) / abs(material.against_stress.slope.value)
    return float(stress_kPa * plan.indenter.area_mm2 * 1e-3)


def _list_pressed_mm(plan: Plan, settings: AnalysisSettings, phase: int) -> Array:
    """Places (p, 2) of presses of earlier phases that calibrate."""
    loads = [
        scheduled.step.load
        for earlier in schedule(plan)[:phase]
        if earlier.name in settings.calibrate_phases and earlier.goal is None
        for scheduled in earlier.steps
        if isinstance(scheduled.step, Press)
    ]
    return np.array([(load.x_mm, load.y_mm) for load in loads])
