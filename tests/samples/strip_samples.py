"""Press cycles on a strip of known material, in closed form: no mesh, no bench, no time step."""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from cbsr_qa.calibration.fits.superposition import StepTrace
from cbsr_qa.calibration.strip.characterisation import Specimen
from cbsr_qa.config.loader import load_material, load_sensor_type, load_station
from cbsr_qa.domain.plan.world import SimulatedPress, StrainRamp
from cbsr_qa.domain.results.characterisation import CycleReadings
from cbsr_qa.domain.sensor.sensor_type import Parameter, Relaxation, Response
from cbsr_qa.eit.loads.bodies import StripModel
from cbsr_qa.simulate.ramps import Transients, quasi_static

SPEED = 1 / 6  # strain a second
PAPER = (0.05, 0.10, 0.15, 0.20, 0.25, 0.30)


@dataclass(frozen=True)
class Truth:
    """A material, and what outlasts its relaxation."""

    material: object = load_material("cbsr-8wt").value
    residue: float = 0.0
    decay_s: float = 600.0

    def with_line(self, slope, intercept=0.0):
        """The same with another quasi-static line against strain."""
        line = self.material.against_strain
        line = replace(line, slope=Parameter(slope, None, ""), intercept=Parameter(intercept, None, ""))
        return replace(self, material=replace(self.material, against_strain=line))


@dataclass(frozen=True)
class Cycle:
    """One press: strain, and when it is down, lifts, is up, and has rested."""

    strain: float
    down_s: float
    lift_s: float
    up_s: float
    end_s: float

    def press(self, index):
        """Its strain against time."""
        ramp_s = self.strain / SPEED
        steps = [StrainRamp(self.down_s - ramp_s, ramp_s, self.strain), StrainRamp(self.lift_s, ramp_s, -self.strain)]
        return SimulatedPress(index, 0.0, 0.0, steps)


def cycles(strains, count, hold_s=60.0, rest_s=60.0):
    """Cycles at each strain in turn."""
    found, now_s = [], 10.0
    for strain in strains:
        for _ in range(count):
            ramp_s = strain / SPEED
            down_s = now_s + ramp_s
            found.append(
                Cycle(strain, down_s, down_s + hold_s, down_s + hold_s + ramp_s, down_s + hold_s + ramp_s + rest_s)
            )
            now_s = found[-1].end_s
    return found


def steps_of(truth, planned, period_s=1.0):
    """What the conductance under the head does after every step, without noise."""
    material, line = truth.material, truth.material.against_strain
    transients = Transients(material.loading_relaxation, material.unloading_relaxation, line)
    slow = Relaxation((-truth.residue, 0.0), (truth.decay_s, 2 * truth.decay_s), "")
    fading = Transients(None, slow, line)
    presses = [one.press(k) for k, one in enumerate(planned)]

    def change(at_s):
        return sum(
            quasi_static(line, p.strain_at(at_s)) + transients.change_at(p, at_s) + fading.change_at(p, at_s)
            for p in presses
        )

    steps = []
    for one in planned:
        for start_s, end_s, loading in ((one.down_s, one.lift_s, True), (one.up_s, one.end_s, False)):
            times = np.arange(start_s + period_s / 2, end_s, period_s)
            steps.append(StepTrace(start_s, loading, times - start_s, np.array([change(at_s) for at_s in times])))
    return steps


@lru_cache
def models():
    """The shipped strip with the contacts that are assumed, and with half as much more."""
    sensor_type, head = load_sensor_type("strip-40x20mm").value, load_station("simulated-strip").value.indenter
    return StripModel(sensor_type, head, 0.2), StripModel(sensor_type, head, 0.3)


def specimen(declared=Response.AUTO):
    """What the cycles below were pressed on."""
    strip, other = models()
    return Specimen(strip, other, Parameter(18_100.0, 2.0, "test"), 7.9e-4, declared, "test")


def readings(truth, strains=(0.1, 0.2, 0.3), count=4, noise=7.9e-4, seed=0, force_noise_N=0.01):
    """Cycles as a strip would be read."""
    planned, random = cycles(strains, count), np.random.default_rng(seed)
    steps, strip = steps_of(truth, planned), models()[0]
    kernel = truth.material.stress_relaxation
    stress = Transients(kernel, kernel)

    def read(step):
        return strip.apparent(step.values) + noise * random.standard_normal(len(step.values))

    found, before = [], noise * random.standard_normal(4)
    for k, one in enumerate(planned):
        held, rested, press, ramp_s = read(steps[2 * k]), read(steps[2 * k + 1]), one.press(k), one.strain / SPEED
        at_s = np.arange(one.down_s + 0.5, one.lift_s, 1.0)
        kPa = truth.material.modulus_kPa.value * np.array(
            [press.strain_at(t) + stress.change_at(press, t) for t in at_s]
        )
        kPa += force_noise_N / 0.4 / np.sqrt(8) * random.standard_normal(len(kPa))
        found.append(
            CycleReadings(
                k, one.strain, k % count, one.down_s, one.up_s, ramp_s, ramp_s, steps[2 * k].time_s, held,
                steps[2 * k + 1].time_s, rested, before, at_s - one.down_s, kPa,
            )
        )  # fmt: skip
        before = rested[-4:]
    return found
