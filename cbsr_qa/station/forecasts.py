"""How many presses a phase that decides will make, before anything is measured: those of a usual sheet."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import gammaincinv

from cbsr_qa.calibration.force.interpolation import interpolate
from cbsr_qa.calibration.force.templates import make_even_model, template_bank
from cbsr_qa.calibration.sheet.usual_sheet import USUAL_SCATTER, order_presses
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
    """

    phase: int
    least: int
    expected: int
    most: int
    noise_N: float
    floor_N: float
    reached: bool


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
    lever_N = choice.matter.lever_N(per_strain_N, material.against_stress, head)
    shared = _SHARED if settings.transients == "predicted" else 0.0
    _, left = order_presses(
        choice.places_mm(list(choice.loads)),
        places_mm,
        goal.at_most,
        pressed_mm=_list_pressed_mm(plan, settings, phase),
        radius_mm=plan.sensor_type.radius_mm,
    )
    bound = gammaincinv(_FREEDOM / 2, goal.confidence) / (_FREEDOM / 2)
    errors_N = np.hypot(noise_N, lever_N * np.sqrt(bound * (left + shared**2) + USUAL_SCATTER**2))
    enough = np.flatnonzero(errors_N <= goal.target_N) + 1
    expected = max(int(enough[0]), goal.at_least) if len(enough) else goal.at_most
    floor_N = float(np.hypot(noise_N, lever_N * np.hypot(shared, USUAL_SCATTER)))
    return PressForecast(phase, goal.at_least, expected, goal.at_most, noise_N, floor_N, len(enough) > 0)


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
