"""Trials of transient compensation: sensors alike but not the same, their calibration runs, and loads held shortly.

The effects of the simulated world make the traces; the noise of an amplitude is what the readings' noise leaves to
an estimate of area × contrast with the place unknown, by its Cramér–Rao bound.
"""

from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from benchmarks.load_bound import load_bound
from cbsr_qa.calibration.fits.relaxation_kernel import learn_kernel
from cbsr_qa.calibration.fits.steady_state import predict_steady
from cbsr_qa.config.loader import load_material, load_sensor_type
from cbsr_qa.domain.plan.world import Moment, SceneSetting, SimulatedPress, StrainRamp
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.domain.results.relaxation import RelaxationKernel
from cbsr_qa.domain.sensor.sensor_type import Material, Relaxation, SensorType
from cbsr_qa.eit.estimate.readings import load_model, merge_reciprocal
from cbsr_qa_plugins.effects.force import ElasticStress, StressRelaxation
from cbsr_qa_plugins.effects.sheet import ConductanceRelaxation, Piezoresistivity, Residue, UnloadingSpike

Array = NDArray[np.float64]

#: Standard deviation of weights and of log τ between sensors.
BETWEEN_SENSORS: Final = 0.1
#: Strain rate of a press, paper: 40 mm/min on 4 mm.
RATE_PER_S: Final = 40 / 60 / 4
HOLD_S: Final = 60.0
RADII_MM: Final = (0.0, 10.0, 20.0, 30.0, 40.0)


@dataclass(frozen=True, slots=True)
class Trial:
    """What is tried.

    Parameters
    ----------
    period_s : of a frame, read at its middle.
    scatter : standard deviation of each weight between a sensor's loads, relative.
    loads : of a calibration run: nine at 20 % strain, the others at 5 to 30 %.
    sensors, held : how many sensors, and loads of each.
    seed : of all.
    signal : "conductance" or "stress".
    releases : whether releases are held short, and what they leave is predicted.
    share : of the settling time that is seen.
    radius_mm : of all places; None for uniform in 0 to 40 mm.
    strains : of the loads held shortly.
    """

    period_s: float = 2.5
    scatter: float = 0.02
    loads: int = 23
    sensors: int = 40
    held: int = 25
    seed: int = 0
    signal: str = "conductance"
    releases: bool = False
    share: float = 0.3
    radius_mm: float | None = None
    strains: tuple[float, float] = (0.2, 0.3)


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """Errors of every load held shortly, relative to its steady change (releases: to what was released).

    Parameters
    ----------
    error, stderr, freedom : (loads,) of predictions.
    uncompensated : (loads,) of the last frame seen, taken as it is.
    misfit : (loads,).
    bound : (loads,) Cramér–Rao bound of the error if the load's kernel were known.
    frames : how many were seen.
    """

    error: Array
    stderr: Array
    freedom: Array
    uncompensated: Array
    misfit: Array
    bound: Array
    frames: int

    def cover(self, level: float) -> float:
        """Share of intervals of a level that hold the truth."""
        reach = student.ppf((1 + level) / 2, np.minimum(self.freedom, 1e9)) * self.stderr
        return float(np.mean(np.abs(self.error) <= reach))


def rms(values: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


@cache
def material() -> Material:
    """The 8 wt% material as shipped."""
    return load_material("cbsr-8wt").value


@cache
def sensor_type() -> SensorType:
    """The 100 mm disc."""
    return load_sensor_type("disc-100mm").value


@cache
def noise_by_radius(known_place: bool = False) -> Array:
    """Standard deviation of one frame's contrast at each of RADII_MM, at 20 % strain."""
    sensor = sensor_type()
    model, used = load_model(sensor), sensor.pattern.usable()
    size = np.abs(model.solve_unloaded())[used].mean()
    variance = np.full(used.shape, (material().relative_noise.value * size) ** 2)
    readings = merge_reciprocal(sensor.pattern, used, variance)
    contrast = material().against_strain.slope.value * 0.2
    stderr = []
    for radius_mm in RADII_MM:
        bound = load_bound(model, readings, x_mm=radius_mm, y_mm=0.0, radius_mm=6.5, contrast=contrast, known=True)
        stderr.append(contrast * (1 / bound.detectability if known_place else bound.strength))
    return np.array(stderr)


def tried(trial: Trial) -> Found:
    """Calibrate sensors, hold loads of each shortly, and predict where they end."""
    parts = [_sensor(trial, number) for number in range(trial.sensors)]
    joined: list[Any] = [np.concatenate(part) for part in zip(*parts, strict=True)]
    return Found(*joined, frames=int(_short(trial).sum()))


def relaxing_s(trial: Trial) -> float:
    """Settling time of the material's nominal kernel in the trial's direction: 30 and 36 s."""
    kernel = material().unloading_relaxation if trial.releases else material().loading_relaxation
    return kernel.time_constants_s[1] * float(np.log(abs(kernel.weights[1]) / 0.15))


def _short(trial: Trial) -> NDArray[np.bool_]:
    """Which frames of a hold are over within the share that is seen."""
    seen: NDArray[np.bool_] = _times_s(trial) + trial.period_s / 2 <= trial.share * relaxing_s(trial) + 1e-9
    return seen


def _times_s(trial: Trial) -> Array:
    return np.arange(trial.period_s / 2, HOLD_S, trial.period_s)


def _sensor(trial: Trial, number: int) -> tuple[Array, ...]:
    random = np.random.default_rng([trial.seed, number])
    own = _varied(material(), random, BETWEEN_SENSORS, BETWEEN_SENSORS)
    strains = np.where(np.arange(trial.loads) < 9, 0.2, random.uniform(0.05, 0.3, trial.loads))
    kernel, at_release = _learned(trial, [_Load(trial, own, strain, random) for strain in strains], strains)
    seen = _short(trial)
    time_s = _times_s(trial)[seen]
    strains = random.uniform(*trial.strains, trial.held)
    held = [_Load(trial, own, strain, random, whole=trial.releases) for strain in strains]
    values = np.array([load.released[seen] if trial.releases else load.pressed for load in held])
    ramps = np.array([load.ramp_s for load in held])
    noise = np.array([load.noise for load in held])[:, None]
    options: dict[str, Any] = {}
    if trial.releases:
        whole = np.array([load.pressed for load in held])
        end = predict_steady(_times_s(trial), whole, noise, at_release, ramp_s=ramps).values
        last = predict_steady(_times_s(trial), whole, noise, at_release, ramp_s=ramps, at_s=HOLD_S)
        options = {"released": last.values, "released_stderr": last.stderr, "at_s": HOLD_S}
        truth, scale = np.array([load.left for load in held]), end
    else:
        truth = scale = np.array([load.steady for load in held])
    found = predict_steady(time_s, values, noise, kernel, ramp_s=ramps, **options)
    errors = (found.values - truth) / scale, found.stderr / np.abs(scale), found.freedom
    sure = replace(kernel, covariance=np.zeros_like(kernel.covariance), scatter=np.zeros_like(kernel.scatter))
    bound = predict_steady(time_s, values, noise, sure, ramp_s=ramps, **options).stderr / np.abs(scale)
    return *errors, (values[:, -1] - truth) / scale, found.misfit, bound


def _learned(trial: Trial, loads: "list[_Load]", strains: Array) -> tuple[RelaxationKernel, RelaxationKernel]:
    """Kernel of the direction that is tried, and of loadings."""
    ramps = (strains / RATE_PER_S).tolist()
    pressing = learn_kernel([(_times_s(trial), load.pressed) for load in loads], ramp_s=ramps)
    if not trial.releases:
        return pressing, pressing
    whole = np.array([load.pressed for load in loads])
    noise = np.array([load.noise for load in loads])[:, None]
    end = predict_steady(_times_s(trial), whole, noise, pressing, ramp_s=np.array(ramps), at_s=HOLD_S)
    traces = [(_times_s(trial), load.released) for load in loads]
    return learn_kernel(traces, ramp_s=ramps, released=end.values.tolist()), pressing


class _Load:
    """One press with its release, as frames see it."""

    def __init__(
        self, trial: Trial, own: Material, strain: float, random: np.random.Generator, *, whole: bool = True
    ) -> None:
        of = _varied(own, random, trial.scatter, 0.0)
        setting = SceneSetting(sensor_type(), of, Indenter(13.0), trial.seed, 1e-3)
        self.ramp_s = float(strain) / RATE_PER_S
        up_s = self.ramp_s + HOLD_S
        steps = [StrainRamp(0.0, self.ramp_s, strain), StrainRamp(up_s, self.ramp_s, -strain)]
        press = SimulatedPress(0, 0.0, 0.0, steps)
        stress = trial.signal == "stress"
        effects = _stress_effects(setting) if stress else _conductance_effects(setting)
        radius_mm = random.uniform(0.0, 40.0) if trial.radius_mm is None else trial.radius_mm
        self.noise = 0.01 * 26.5 if stress else float(np.interp(radius_mm, RADII_MM, noise_by_radius()))
        times_s = _times_s(trial) if whole else _times_s(trial)[_short(trial)]
        self.pressed = self._seen(setting, effects, press, self.ramp_s + times_s, random, stress)
        self.steady = float(of.modulus_kPa.value if stress else of.against_strain.slope.value) * float(strain)
        if trial.releases:
            over_s = up_s + self.ramp_s
            self.released = self._seen(setting, effects, press, over_s + times_s, random, stress)
            self.left = float(_exact(setting, effects, press, np.array([over_s + HOLD_S]), stress)[0])

    def _seen(
        self,
        setting: SceneSetting,
        effects: list[Any],
        press: SimulatedPress,
        times_s: Array,
        random: np.random.Generator,
        stress: bool,
    ) -> Array:
        exact = _exact(setting, effects, press, times_s, stress)
        return exact + self.noise * random.standard_normal(len(times_s))


def _exact(setting: SceneSetting, effects: list[Any], press: SimulatedPress, times_s: Array, stress: bool) -> Array:
    values = []
    for time_s in times_s.tolist():
        moment = Moment(setting, time_s, 0, [press], [0.0], [0.0])
        for effect in effects:
            effect.apply(moment)
        values.append(moment.stress_kPa[0] if stress else moment.response[0])
    return np.array(values)


def _conductance_effects(setting: SceneSetting) -> list[Any]:
    """As the scene ``everything`` has them."""
    return [
        Piezoresistivity(setting),
        ConductanceRelaxation(setting),
        UnloadingSpike(setting, size=0.1, decay_s=3.0),
        Residue(setting, share=0.03, decay_s=300.0),
    ]


def _stress_effects(setting: SceneSetting) -> list[Any]:
    return [ElasticStress(setting), StressRelaxation(setting)]


def _varied(of: Material, random: np.random.Generator, weights: float, log_times: float) -> Material:
    def other(kernel: Relaxation) -> Relaxation:
        near = np.array(kernel.weights) * (1 + weights * random.standard_normal(2))
        times_s = np.array(kernel.time_constants_s) * np.exp(log_times * random.standard_normal(2))
        return replace(kernel, weights=tuple(near.tolist()), time_constants_s=tuple(times_s.tolist()))

    return replace(
        of,
        loading_relaxation=other(of.loading_relaxation),
        unloading_relaxation=other(of.unloading_relaxation),
        stress_relaxation=other(of.stress_relaxation),
    )
