"""A small run, made of Gaussian bumps instead of a bench, for the tests of the report."""

from dataclasses import replace
from datetime import UTC, datetime
from functools import cache

import numpy as np
from load_samples import Sampler, planned_loads, sample_force, sample_frames, sample_timeline
from measurement_samples import sample_measurements
from sensor_samples import BANDS, FLOOR, INDENTER, SENSOR, SETTINGS, sample_material

from cbsr_qa.domain.imaging import ImagingProblem, LinearReconstruction, ParameterChoice
from cbsr_qa.domain.plan.steps import Role
from cbsr_qa.domain.readings.loads import NINE_LOCATIONS_MM
from cbsr_qa.domain.results.calibration import BaselineConductance, Calibration, SettlingSummary, Validity
from cbsr_qa.domain.results.measurement import Verdict, decide
from cbsr_qa.domain.results.observation import RunObservation
from cbsr_qa.domain.results.run_result import RunResult
from cbsr_qa.domain.run.run import InstrumentIdentity, PhaseRecord, RunIdentity, RunRecord
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.domain.sensor.sensor_type import Response, SensorIdentity


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


@cache
def sample_run(size_mm=3.0, **identity):
    """A whole run of 23 loads with every section's data in it, the same object for all: nobody changes it."""
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
    unloaded = phases[0].frames.select_interval(0, 240)
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


def without_blobs(result):
    """The same run, in which no image rises above its noise floor."""
    observation = result.observation
    loads = tuple(
        replace(load, masks=tuple(replace(view, blobs=(), sensed=None) for view in load.masks))
        for load in observation.loads
    )
    lost = tuple(
        m if m.unit not in ("mm", "%", "mm²") else replace(m, value=None, how="not detected")
        for m in result.measurements
    )
    return replace(result, observation=replace(observation, loads=loads, timelines=()), measurements=lost)
