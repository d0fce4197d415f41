"""A small run, made of Gaussian bumps instead of a bench, for the tests of the report."""

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from cbsr_qa.domain.calibration import BaselineConductance, Calibration, OverlapBand, SettlingSummary, Validity
from cbsr_qa.domain.electrodes import ElectrodeKind, ElectrodeLayout
from cbsr_qa.domain.frames import FrameBlock, SampleBlock, VoltageUnit
from cbsr_qa.domain.image import Image
from cbsr_qa.domain.load_events import ChannelReport, LoadEvent, NoiseReport, RecordingResult
from cbsr_qa.domain.loads import NINE_LOCATIONS_MM, Indenter, Load, LoadRecord
from cbsr_qa.domain.measurement import Limit, Measurement, Verdict, decide
from cbsr_qa.domain.mesh import Mesh
from cbsr_qa.domain.observation import (
    LoadObservation,
    MaskView,
    MetricTimeline,
    RelaxationObservation,
    RunObservation,
    Trace,
)
from cbsr_qa.domain.outcome import EndReason
from cbsr_qa.domain.patterns import adjacent_pattern
from cbsr_qa.domain.plan import AnalysisSettings
from cbsr_qa.domain.reconstruction import ImagingProblem, LinearReconstruction, ParameterChoice
from cbsr_qa.domain.recording import Recording, ScanKind
from cbsr_qa.domain.relaxation import FitStatus, RelaxationFit, SettlingTime
from cbsr_qa.domain.report import RunResult
from cbsr_qa.domain.run import InstrumentIdentity, PhaseRecord, RunIdentity, RunRecord
from cbsr_qa.domain.sensor import (
    Material,
    Parameter,
    QuasiStatic,
    Relaxation,
    Response,
    SensorIdentity,
    SensorType,
)
from cbsr_qa.domain.steps import Role
from cbsr_qa.forward.meshing import image_mesh
from cbsr_qa.imaging.blobs import find_blobs, nearest_blob
from cbsr_qa.imaging.masks import percentage_mask
from cbsr_qa.imaging.noise_floor import floored
from cbsr_qa.imaging.shape import area_overlap_percent, centre_of_mass_error_mm, shape_deviation_mm2

MASKS = (0.25, 0.5, 0.75, 0.85)
BANDS = (OverlapBand("likely poor", 0, 50), OverlapBand("ok", 50, 70), OverlapBand("good", 70, 100))
SETTINGS = AnalysisSettings(
    masks=MASKS,
    main_mask=0.85,
    noise_floor_frames=8,
    reference="run",
    reference_frames=4,
    steady_frames=8,
    settling_multiple=1.5,
    settling_tolerance=0.15,
    settling_band="steady",
    r_squared_gate=0.85,
    overlap_bands=BANDS,
    size_ratio=(1 / 3, 3.0),
    clipping="exact",
    perimeter="length",
    outline="elements",
)
SENSOR = SensorType(
    name="disc-100mm",
    radius_mm=50.0,
    thickness_mm=4.0,
    electrodes=ElectrodeLayout(16, ElectrodeKind.PIN, 48.0, 0.65, 90.0, False),
    pattern=adjacent_pattern(16),
    response=Response.AUTO,
)
INDENTER = Indenter(13.0)
FLOOR = 0.003
_PERIOD_S = 2.5


def _parameter(value, stderr=None, source="a test"):
    return Parameter(value, stderr, source)


def sample_material():
    fit = QuasiStatic(_parameter(0.0045, 0.0003), _parameter(0.001, 0.002))
    slow = Relaxation((0.2, 0.1), (3.0, 20.0), "a test")
    return Material(
        name="cbsr-8wt",
        interelectrode_resistance_ohm=_parameter(18.1e3, 9.8e3),
        modulus_kPa=_parameter(132.5),
        against_stress=fit,
        against_strain=QuasiStatic(_parameter(0.6, 0.05), _parameter(0.0, 0.01)),
        stress_relaxation=slow,
        loading_relaxation=slow,
        unloading_relaxation=slow,
        relative_noise=_parameter(1e-4),
    )


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
        shown = Image(self.mesh, floored(image.values, FLOOR))
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
                    tables[0][mask, frame] = centre_of_mass_error_mm(view.sensed, INDENTER.at(*place))
                    tables[1][mask, frame] = area_overlap_percent(view.sensed, INDENTER.at(*place))
                    tables[2][mask, frame] = shape_deviation_mm2(view.sensed, INDENTER.at(*place))
    return MetricTimeline(phase, frames.time_s, MASKS, tables[0], tables[1], tables[2], force)


def sample_measurements(loads):
    found = []
    for load in loads:
        wanted = load.record.load
        place = (wanted.x_mm, wanted.y_mm)
        about = {"phase": load.phase, "location": wanted.label, "trial": wanted.trial, "load": load.record.index}
        for view in load.masks:
            main = abs(view.fraction - 0.85) < 1e-9
            about["qualifier"] = "" if main else f"mask {100 * view.fraction:g} %"
            blob = view.sensed
            values = (
                ("centre_of_mass_error", "mm", blob and centre_of_mass_error_mm(blob, INDENTER.at(*place)), ""),
                (
                    "area_overlap",
                    "%",
                    blob and area_overlap_percent(blob, INDENTER.at(*place)),
                    "good; exact clipping",
                ),
                ("shape_deviation", "mm²", blob and shape_deviation_mm2(blob, INDENTER.at(*place)), ""),
            )
            found += [
                Measurement(n, v, u, how=h if v is not None else "not detected", **about) for n, u, v, h in values
            ]
        found += [
            Measurement(name, value, "mm" if name == "position_error" else "1", **{**about, "qualifier": ""})
            for name, value in (
                ("amplitude_response", 0.9),
                ("position_error", 0.04 * np.hypot(*place)),
                ("resolution", 0.3),
                ("shape_deformation", 0.05),
                ("ringing", 0.2),
                ("false_regions", 0.0),
                ("detectability", 40.0),
            )
        ]
    found += [
        Measurement("two_touch_resolution", 29.0, "mm", how="contours at 85 %; steps of 0.5 mm"),
        Measurement("merged_loads", 1.0, "1"),
        Measurement("size_response", 0.1, "1", qualifier="centre", how="flat"),
        *(
            Measurement("region_area", area, "mm²", qualifier=f"centre, target of {diameter} mm")
            for diameter, area in ((8, 131.0), (13, 133.0), (20, 142.0))
        ),
    ]
    found += [
        Measurement("force_error_sd", 0.1, "N", 0.02, qualifier="place known", how="10 loads"),
        Measurement("repeatability", 1.4, "%", 0.3, how="of the place's span"),
        Measurement("apparent_modulus", 132.0, "kPa", 0.5, how="9 locations"),
        *(Measurement("apparent_modulus", 130.0 + k, "kPa", location=f"L{k}") for k in range(9)),
    ]
    limit = Limit("centre_of_mass_error", "mm", None, 5.0, marginal=0.5, phase="nine")
    judged = [
        m.judged(limit) if (m.name, m.phase, m.qualifier) == ("centre_of_mass_error", "nine", "") else m
        for m in found
    ]
    judged.append(
        Measurement("noise_figure", 1.07, "1", 0.08, phase="noise").judged(Limit("noise_figure", "1", 0.5, 1.5))
    )
    judged.append(Measurement("channel_snr", 58.3, "dB", qualifier="median", how="208 used readings"))
    judged += [
        Measurement("contact_resistance", 18.1e3 + 900 * np.sin(k), "Ω", 40.0, qualifier=f"pair {k}-{(k + 1) % 16}")
        for k in range(16)
    ]
    return tuple(judged)


def sample_identity(serial="SN-0042", simulated=("all instruments", "the sensor (scene base)")):
    bench = InstrumentIdentity("bench", "simulated-bench", "simulated bench", "0", "1", bool(simulated), "2027-01-31")
    return RunIdentity(
        run="0199a000-0000-7000-8000-000000000001",
        sensor=SensorIdentity(serial, "B41", "disc-100mm"),
        station="simulated",
        recipe="nine-locations",
        operator="somebody",
        started_at=datetime(2026, 3, 1, 9, 30, tzinfo=UTC),
        configuration_digest="3f" * 32,
        software=(("cbsr-qa", "0.1.0"), ("numpy", "2.0")),
        instruments=(bench,),
        simulated=tuple(simulated),
    )


def sample_record(phases, **identity):
    return RunRecord(
        identity=sample_identity(**identity),
        sensor_type=SENSOR,
        material=sample_material(),
        indenter=INDENTER,
        phases=tuple(phases),
        end=EndReason.FINISHED,
        station_s=3300.0,
        spent=(("hold", 1380.0), ("rest", 1380.0), ("travel", 410.0), ("find surface", 90.0), ("home", 40.0)),
    )


def sample_reconstruction(mesh):
    used = SENSOR.pattern.usable()
    count = int(used.sum())
    problem = ImagingProblem(SENSOR, mesh, np.zeros((count, len(mesh.elements))), np.ones(count), used)
    choice = ParameterChoice(0.0123, "noise figure 1.00 on the nominal model", 1.0, criterion="noise-figure")
    return LinearReconstruction("gauss-newton-noser", problem, np.zeros((len(mesh.elements), count)), choice)


def sample_calibration(observation):
    places = tuple(
        BaselineConductance(f"L{k}", x, y, 1.1 + 0.06 * np.sin(k), 0.02 + 0.002 * k, 1)
        for k, (x, y) in enumerate(NINE_LOCATIONS_MM)
    )
    material = observation.record.material
    return Calibration(
        calibration="c",
        run=observation.record.identity.run,
        issued_at="2026-03-01T10:00:00+00:00",
        sensor=observation.record.identity.sensor,
        sensor_type=SENSOR,
        indenter=INDENTER,
        reference=observation.reference,
        current_A=1e-3,
        scale=1.0,
        reconstruction=observation.reconstruction,
        response=Response.INCREASE,
        noise_floor=FLOOR,
        mask=0.85,
        baseline=places,
        against_stress=material.against_stress,
        against_strain=material.against_strain,
        assumed=("α and β against stress", "α and β against strain"),
        settling=(SettlingSummary("conductance", True, 12.0, 1.0, 20, 0, 0),),
        overlap_bands=BANDS,
        overlap_threshold=50.0,
        validity=Validity((0.9, 5.3), (0.05, 0.3), None, 40.0, ("only one strain at the nine locations",)),
    )


def sample_run(size_mm=3.0, **identity):
    """A whole run of 23 loads with every section's data in it."""
    sampler = Sampler(size_mm=size_mm)
    phases, loads, timelines, start_s = [], [], [], 0.0
    for (name, role), planned in planned_loads().items():
        began = start_s
        start_s += 240 if role is Role.NOISE else 20
        own = []
        for index, load in enumerate(planned):
            own.append(sampler.load(name, index, load, start_s))
            start_s += 124
        frames = sample_frames(began, start_s, sampler.random)
        force = sample_force(own, began, start_s)
        records = tuple(load.record for load in own)
        phases.append(PhaseRecord(len(phases), name, "any", began, start_s, frames, (force,), records, role=role))
        if role is Role.GRID:
            timelines.append(sample_timeline(sampler, name, frames, own, force))
        loads += own
    record = sample_record(phases, **identity)
    unloaded = phases[0].frames.between(0, 240)
    observation = RunObservation(
        record=record,
        reconstruction=sample_reconstruction(sampler.mesh),
        scale=1.0,
        unloaded=unloaded,
        reference=unloaded.voltages.mean(axis=0),
        noise_floor=FLOOR,
        noise_images=np.full((8, len(sampler.mesh.elements)), 0.001),
        response=Response.INCREASE,
        response_how="all 23 loads agree",
        main_mask=0.85,
        loads=tuple(loads),
        usable=SENSOR.pattern.usable(),
        settings=SETTINGS,
        warnings=("in 3 of 23 holds the last frames were taken before 1.5 settling times had passed",),
        timelines=tuple(timelines),
    )
    measurements = sample_measurements(loads)
    return RunResult(
        record=record,
        observation=observation,
        measurements=measurements,
        verdict=decide(measurements),
        calibration=sample_calibration(observation),
        calibration_why="",
        compute_s=(("images", 0.8), ("metrics", 0.6), ("simulate", 2.1)),
    )


def sample_recording(events=2):
    """A recording of bumps in units of the radius, with as many events as asked for."""
    mesh = image_mesh(SENSOR, size_mm=6.0)
    mesh = Mesh(mesh.nodes_mm / 50.0, mesh.elements)
    frames = sample_frames(0.0, 100.0, np.random.default_rng(5))
    recording = Recording(
        path=Path("exp<1>.csv"),
        format="ert-board-csv",
        dataset="",
        scan=ScanKind.FULL,
        frames=frames,
        reference=None,
        still=False,
        magnitudes_only=False,
        clock="board",
    )
    found = tuple(
        LoadEvent(
            start_s=20.0 * k + 5,
            peak_s=20.0 * k + 9,
            end_s=20.0 * k + 15,
            x_over_R=0.5 * np.cos(k),
            y_over_R=0.5 * np.sin(k),
            electrode=2.0 * k,
            sign=-1,
            snr=20.0 + k,
            image=Image(mesh, -np.exp(-((mesh.centroids_mm - [0.5 * np.cos(k), 0.5 * np.sin(k)]) ** 2).sum(axis=1))),
        )
        for k in range(events)
    )
    why = "" if events else "nothing stands out of the noise"
    noise = NoiseReport(0.01, "V", 0.0, (), (0.0, 20.0), 8)
    channels = ChannelReport((), (), False, 208, 58.0, 0.01, None, None, False)
    return RecordingResult(recording, 0.4, channels, noise, found, why)


def ended_early(result, detail="SIGINT"):
    """The same run, stopped before anything could be analysed."""
    record = replace(result.record, end=EndReason.ABORTED, end_detail=detail, spent=())
    verdict = Verdict(decide(()).outcome, "nothing was analysed")
    return replace(
        result,
        record=record,
        observation=None,
        measurements=(),
        verdict=verdict,
        calibration=None,
        calibration_why="the run did not finish",
        compute_s=(),
    )
