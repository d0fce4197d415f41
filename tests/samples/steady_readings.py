"""Transient compensation through the readings of a whole simulated run: amplitudes matched frame by frame."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from simulated_runs import simulated_run
from steady_trials import RATE_PER_S, Found, material, sensor_type

from cbsr_qa.analysis.run.estimates import model_scale
from cbsr_qa.calibration.fits.relaxation_kernel import learn_kernel
from cbsr_qa.calibration.fits.steady_state import predict_steady
from cbsr_qa.domain.readings.loads import NINE_LOCATIONS_MM, Load
from cbsr_qa.domain.run.run import RunRecord
from cbsr_qa.eit.estimate.readings import load_model
from cbsr_qa.eit.loads.round_load import RoundLoads

Array = NDArray[np.float64]

_CALIBRATED, _HELD, _PERIOD_S, _SEEN_S = 19, 14, 2.5, 9.0


@dataclass(frozen=True, slots=True, eq=False)
class _Hold:
    time_s: Array
    values: Array
    noise: float
    ramp_s: float


def through_readings(seeds: range, scene: str = "base") -> Found:
    """Calibrate with nine locations and ten random loads of each run, hold the other random loads shortly.

    Truth is the prediction from the whole hold, and ``bound`` the standard error of that.
    """
    parts = [_of_run(simulated_run((), scene=scene, seed=100 + seed, loads=_loads(seed))) for seed in seeds]
    frames = int(_SEEN_S / _PERIOD_S)
    return Found(
        *(np.array(part) for part in zip(*[row for rows in parts for row in rows], strict=True)), frames=frames
    )


def _loads(seed: int) -> tuple[Load, ...]:
    random, count = np.random.default_rng(seed), _CALIBRATED - 9 + _HELD
    away, angle = random.uniform(0, 40, count), random.uniform(0, 2 * np.pi, count)
    strain, x, y = random.uniform(0.2, 0.3, count), away * np.cos(angle), away * np.sin(angle)
    grid = [Load(f"L{k}", x_mm, y_mm, 0.2, 0) for k, (x_mm, y_mm) in enumerate(NINE_LOCATIONS_MM)]
    return (*grid, *(Load(f"R{k}", float(x[k]), float(y[k]), float(strain[k]), 0) for k in range(count)))


def _of_run(record: RunRecord) -> list[tuple[float, ...]]:
    holds = _holds(record)
    known, held = holds[:_CALIBRATED], holds[_CALIBRATED:]
    kernel = learn_kernel(
        [(hold.time_s, hold.values) for hold in known],
        ramp_s=[hold.ramp_s for hold in known],
        noise=[hold.noise for hold in known],
    )
    rows = []
    for hold in held:
        short = hold.time_s + _PERIOD_S / 2 <= _SEEN_S + 0.01
        end = predict_steady(hold.time_s, hold.values, hold.noise, kernel, ramp_s=hold.ramp_s)
        seen = predict_steady(hold.time_s[short], hold.values[short], hold.noise, kernel, ramp_s=hold.ramp_s)
        steady = float(end.values[0])
        last = hold.values[short][-1] / steady - 1
        bound = float(end.stderr[0]) / steady
        rows.append(
            (seen.values[0] / steady - 1, seen.stderr[0] / steady, seen.freedom[0], last, seen.misfit[0], bound)
        )
    return rows


def _holds(record: RunRecord) -> list[_Hold]:
    phase, model, used = record.phases[0], load_model(sensor_type()), sensor_type().pattern.usable()
    time_s, voltages = phase.frames.time_s, phase.frames.voltages
    reference = voltages[time_s < phase.loads[0].hold_start_s - 5].mean(axis=0)
    scale = model_scale(model, reference, used)
    noise = material().relative_noise.value * np.abs(model.solve_unloaded())[used].mean()
    holds = []
    for one in phase.loads:
        place = np.array([[one.load.x_mm, one.load.y_mm]])
        signal = model.readings(RoundLoads.from_contrast(place, np.array([6.5]), np.array([0.12]))).change[0][used]
        inside = (time_s >= one.hold_start_s) & (time_s < one.release_start_s)
        matched = (voltages[inside] - reference)[:, used] / scale @ signal / (signal @ signal)
        ramp_s = one.load.strain / RATE_PER_S
        holds.append(_Hold(time_s[inside] - one.hold_start_s, matched, float(noise / np.linalg.norm(signal)), ramp_s))
    return holds
