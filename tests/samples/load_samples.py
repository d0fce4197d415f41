"""Loads of the sample run, made of Gaussian bumps instead of a bench: images, traces, frames and forces."""

import numpy as np
from sensor_samples import FLOOR, INDENTER, MASKS, SENSOR

from cbsr_qa.domain.imaging import Image
from cbsr_qa.domain.plan.steps import Role
from cbsr_qa.domain.readings.frames import FrameBlock, SampleBlock, VoltageUnit
from cbsr_qa.domain.readings.loads import NINE_LOCATIONS_MM, Load, LoadRecord
from cbsr_qa.domain.results.observation import LoadObservation, MaskView, MetricTimeline, RelaxationObservation, Trace
from cbsr_qa.domain.results.relaxation import FitStatus, RelaxationFit, SettlingTime
from cbsr_qa.domain.sensor.sensor_type import Response
from cbsr_qa.eit.imaging.blobs import find_blobs, nearest_blob, percentage_mask, subtract_noise_floor
from cbsr_qa.eit.imaging.shape import area_overlap_percent, centre_of_mass_error_mm, shape_deviation_mm2
from cbsr_qa.eit.mesh.sheet import image_mesh

_PERIOD_S = 2.5


class Sampler:
    """Makes loads, images and traces from one seeded generator."""

    def __init__(self, seed=1, size_mm=3.0):
        self.random = np.random.default_rng(seed)
        self.mesh = image_mesh(SENSOR, size_mm=size_mm)

    def bump(self, x_mm, y_mm, strain):
        """A Gaussian whose 85 % contour is about the head's rim, seen a little beside its place."""
        seen = np.array([x_mm, y_mm]) + self.random.normal(0, 0.3 + 0.04 / strain, 2)
        far = ((self.mesh.centroids_mm - seen) ** 2).sum(axis=1)
        width = INDENTER.radius_mm**2 / -np.log(0.85)
        ringing = 0.04 * np.cos(self.mesh.centroids_mm @ np.array([0.11, 0.07]))
        noise = self.random.normal(0, 0.001, len(far))
        return Image(self.mesh, 0.6 * strain * (np.exp(-far / width) - ringing) + noise)

    def views(self, image, x_mm, y_mm):
        shown = Image(self.mesh, subtract_noise_floor(image.values, FLOOR))
        views = []
        for fraction in MASKS:
            blobs = find_blobs(shown, percentage_mask(shown.values, fraction))
            views.append(MaskView(fraction, blobs, nearest_blob(blobs, x_mm, y_mm)))
        return tuple(views)

    def relaxation(self, signal, unit, level, loading, start_s=0.0):
        time_s = start_s + np.arange(0, 60, _PERIOD_S if signal != "stress" else 0.125)
        end = level if loading else 0.05 * level
        amplitudes, taus = (0.18 * level, 0.3 * level), (2.0, 14.0 if loading else 19.0)
        clean = end + amplitudes[0] * np.exp(-time_s / taus[0]) + amplitudes[1] * np.exp(-time_s / taus[1])
        noise = self.random.normal(0, 0.01 * abs(level), len(time_s))
        fit = RelaxationFit(FitStatus.TWO, end, amplitudes, taus, 0.002, (0.4, 1.1), 0.991, "")
        settling = SettlingTime(taus[1] * np.log(2) * (1 + 0.05 * self.random.random()), False, 0.15 * level, "")
        return RelaxationObservation(signal, loading, Trace(signal, unit, time_s, clean + noise), fit, settling)

    def load(self, phase, index, load, start_s):
        image = self.bump(load.x_mm, load.y_mm, load.strain)
        force_N = 132.5e-3 * load.strain * INDENTER.area_mm2
        signals = (("conductance", "1", 0.6 * load.strain), ("stress", "kPa", 132.5 * load.strain))
        relaxations = tuple(self.relaxation(s, u, level, on) for s, u, level in signals for on in (True, False))
        record = LoadRecord(index, load, start_s, start_s + 2, start_s + 62, start_s + 64, start_s + 122)
        views = self.views(image, load.x_mm, load.y_mm)
        return LoadObservation(
            phase=phase,
            record=record,
            indenter=INDENTER,
            image=image,
            response=Response.INCREASE,
            noise_floor=FLOOR,
            masks=views,
            steady_frames=8,
            settled=True,
            force_N=force_N,
            force_stderr_N=0.011,
            relaxations=relaxations,
        )


def planned_loads(seed=3):
    random = np.random.default_rng(seed)
    radius, angle = 40 * random.random(10), 2 * np.pi * random.random(10)
    strains = 0.05 + 0.25 * random.random(10)
    return {
        ("noise", Role.NOISE): [Load("L0", 0.0, 0.0, 0.2, trial) for trial in range(3)],
        ("nine", Role.GRID): [Load(f"L{k}", x, y, 0.2, 0) for k, (x, y) in enumerate(NINE_LOCATIONS_MM)],
        ("random", Role.RANDOM): [
            Load(f"R{k}", float(r * np.cos(a)), float(r * np.sin(a)), float(s), 0)
            for k, (r, a, s) in enumerate(zip(radius, angle, strains, strict=True))
        ],
        ("relaxation", Role.RELAXATION): [Load("L0", 0.0, 0.0, 0.2, 0)],
    }


def sample_frames(start_s, end_s, random):
    time_s = np.arange(start_s, end_s, _PERIOD_S)
    level = 0.05 + 0.01 * random.random((16, 16)) + 18.1 * np.eye(16)
    voltages = level * (1 + 1e-3 * random.standard_normal((len(time_s), 16, 16)))
    return FrameBlock(time_s, voltages, np.zeros(voltages.shape, np.uint8), VoltageUnit.VOLT, 1e-3)


def sample_force(loads, start_s, end_s):
    time_s = np.arange(start_s, end_s, 0.125)
    values = np.zeros_like(time_s)
    for load in loads:
        pressed = (time_s >= load.record.hold_start_s) & (time_s < load.record.release_start_s)
        values[pressed] = load.force_N * (1 + 0.2 * np.exp(-(time_s[pressed] - load.record.hold_start_s) / 8))
    return SampleBlock("force", "N", time_s, values)


def sample_timeline(sampler, phase, frames, loads, force):
    shape = (len(MASKS), len(frames))
    tables = [np.full(shape, np.nan) for _ in range(3)]
    for load in loads:
        place = (load.record.load.x_mm, load.record.load.y_mm)
        held = (frames.time_s >= load.record.hold_start_s) & (frames.time_s < load.record.release_start_s)
        for frame in np.flatnonzero(held):
            views = sampler.views(sampler.bump(*place, load.record.load.strain), *place)
            for mask, view in enumerate(views):
                if view.sensed is not None:
                    tables[0][mask, frame] = centre_of_mass_error_mm(view.sensed, INDENTER.footprint_at(*place))
                    tables[1][mask, frame] = area_overlap_percent(view.sensed, INDENTER.footprint_at(*place))
                    tables[2][mask, frame] = shape_deviation_mm2(view.sensed, INDENTER.footprint_at(*place))
    return MetricTimeline(phase, frames.time_s, MASKS, tables[0], tables[1], tables[2], force)
