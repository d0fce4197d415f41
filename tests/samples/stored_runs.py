"""A small run as a stream of documents, for tests of the store."""

import hashlib
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np

from cbsr_qa.calibration.file.hdf5 import stamp
from cbsr_qa.config.loader import load_material, load_sensor_type
from cbsr_qa.domain.imaging import ImagingProblem, LinearReconstruction, OverlapBand, ParameterChoice
from cbsr_qa.domain.plan.steps import Hold, Home, Press, Role
from cbsr_qa.domain.readings.frames import FrameBlock, SampleBlock, VoltageUnit
from cbsr_qa.domain.readings.loads import Indenter, Load, LoadRecord
from cbsr_qa.domain.results.calibration import (
    BaselineConductance,
    Calibration,
    LoadRelaxation,
    SettlingSummary,
    Validity,
)
from cbsr_qa.domain.results.relaxation import FitStatus, RelaxationFit, SettlingTime
from cbsr_qa.domain.run.attendance import PromptAnswered, PromptShown, RunContinued, RunPaused
from cbsr_qa.domain.run.events import (
    FramesTaken,
    LoadFinished,
    PhaseFinished,
    PhaseStarted,
    RunEnded,
    RunStarted,
    SamplesTaken,
    StepRetried,
    StepStarted,
    Unloaded,
)
from cbsr_qa.domain.run.run import InstrumentIdentity, PressDecided, RunIdentity
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.domain.sensor.sensor_type import Response, SensorIdentity, SensorPart

CONFIGURATION = '{"layout":1,"note":"Δρ"}'
SENSOR_TYPE = load_sensor_type("disc-100mm").value
MATERIAL = load_material("cbsr-8wt").value
INDENTER = Indenter(13.0)
SETTING = {"sensor_type": SENSOR_TYPE, "material": MATERIAL, "indenter": INDENTER}
SPENT = (("press", 1.5), ("hold", 60.0))


def identity(run, serial="S-1"):
    return RunIdentity(
        run=run,
        sensor=SensorIdentity(serial, "B7", "disc-100mm"),
        station="bench-α",
        recipe="short",
        operator="Zoë Ōtani",
        started_at=datetime(2026, 11, 21, 8, 0, 0, 123456, tzinfo=UTC),
        configuration_digest=hashlib.sha256(CONFIGURATION.encode()).hexdigest(),
        software=(("cbsr-qa", "0.1.0"), ("numpy", "2.0")),
        instruments=(
            InstrumentIdentity("smu", "keithley", "2634B", "123", "4.0.1", False, "2027-03-31"),
            InstrumentIdentity("applicator", "marlin", "MK3", "9", "1", True),
        ),
        simulated=("the sheet",),
        parts=(SensorPart("board", "B-9"), SensorPart("sheet", "LOT7", "B")),
    )


def frames(start_s, count=1, *, current_A=4e-4, own_times=False, seed=0):
    """A block of frames every 2.5 s."""
    random = np.random.default_rng(seed)
    time_s = start_s + 2.5 * np.arange(count)
    voltages = random.standard_normal((count, 16, 16)) * 1e-3
    flags = random.integers(0, 8, (count, 16, 16)).astype(np.uint8)
    own = time_s[:, None, None] + random.random((count, 16, 16)) if own_times else None
    return FrameBlock(time_s, voltages, flags, VoltageUnit.VOLT, current_A, own)


def force(start_s, count=20, seed=0):
    """A block of force samples every 0.125 s."""
    values = np.random.default_rng(seed).standard_normal(count)
    return SampleBlock("force", "N", start_s + 0.125 * np.arange(count), values)


def load(label="L0", trial=0):
    return Load(label, 15.0, -15.0, 0.2, trial)


def record(index, start_s):
    return LoadRecord(index, load(trial=index), *(start_s + dt for dt in (0.0, 1.0, 61.0, 62.0, 122.0, 61.25)))


def short_run(run, serial="S-1"):
    """Every kind of document: two phases, one press held to its end in the first, none in the second."""
    return [
        RunStarted(identity(run, serial)),
        PhaseStarted(0, "nine locations", "location-grid", 0.5, Role.GRID),
        StepStarted(0, 0, Home(), 0.5, 300.0),
        StepRetried(0, 0, 1, "the applicator did not answer"),
        Unloaded(0, 3.0),
        FramesTaken(0, frames(4.0, 8, seed=1, own_times=True)),
        SamplesTaken(0, force(4.0)),
        StepStarted(0, 1, Press(load()), 30.0, 200.0),
        FramesTaken(0, frames(32.0, 1, seed=2, own_times=True)),
        SamplesTaken(0, force(32.0, seed=3)),
        LoadFinished(0, record(0, 30.0)),
        PressDecided(
            phase=0,
            pressed=1,
            load=3,
            label="L3",
            x_mm=15.0,
            y_mm=-15.0,
            expected_N=0.31,
            upper_N=0.42,
            floor_N=0.06,
            why="error",
            time_s=152.25,
        ),
        RunPaused(0, 152.5, "Zoë"),
        RunContinued(0, 153.5, "Ada"),
        PromptShown(0, 0, "Turn the sheet over", "sheet.png", 154.0),
        PromptAnswered(0, 0, "done", "Ada", 154.5),
        PhaseFinished(0, 155.0),
        PhaseStarted(1, "relaxation", "relaxation", 155.0),
        StepStarted(1, 0, Hold(60.0, acquire=True), 155.5, 60.0),
        FramesTaken(1, frames(160.0, 2, current_A=None, seed=4)),
        PhaseFinished(1, 200.0),
        RunEnded(EndReason.FINISHED, "", 201.0, SPENT),
    ]


def journalled(repository, events, **options):
    """Journal documents and return the journal; ``options`` of the journal."""
    journal = repository.open_journal(configuration=CONFIGURATION, **SETTING, **options)
    for event in events:
        journal(event)
    return journal


#: One press of the same place and trial at each of two strains, a rejected fit, and one exponential.
RELAXATIONS = (
    LoadRelaxation(
        "L0",
        0,
        "conductance",
        True,
        RelaxationFit(FitStatus.TWO, 0.12, (-0.02, -0.05), (2.5, 23.1), 1e-3, (0.2, 1.5), 0.998, ""),
        SettlingTime(24.0, False, 0.018, ""),
        "campaign",
        0,
        0.05,
    ),
    LoadRelaxation(
        "L0",
        0,
        "conductance",
        True,
        RelaxationFit(FitStatus.ONE, 0.2, (-0.1,), (31.0,), 2e-3, (2.5,), 0.97, "no second time constant"),
        SettlingTime(60.0, True, 0.02, "not settled within 60 s"),
        "campaign",
        9,
        0.1,
    ),
    LoadRelaxation(
        "L1",
        1,
        "stress",
        False,
        RelaxationFit(FitStatus.REJECTED, 0.1, (), (), 0.01, (), 0.0, "3 points are too few"),
        SettlingTime(None, False, 0.0, "rejected"),
        unit="kPa",
    ),
)


def reconstruction():
    """An imaging matrix on two triangles; its numbers mean nothing."""
    nodes = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    mesh = Mesh(nodes, np.array([[0, 1, 2], [0, 2, 3]]))
    used = SENSOR_TYPE.pattern.usable()
    count = int(used.sum())
    problem = ImagingProblem(SENSOR_TYPE, mesh, np.ones((count, 2)), np.ones(count), used)
    return LinearReconstruction(
        "truncated-svd",
        problem,
        np.ones((2, count)),
        ParameterChoice(0.02, "NF 1", 1.0, "share kept", criterion="noise-figure"),
    )


def calibration(name, run, serial="S-1", **changes):
    """A calibration that says something in every field."""
    values = {
        "calibration": name,
        "run": run,
        "issued_at": "2026-11-21T08:30:00+00:00",
        "sensor": SensorIdentity(serial, "B7", "disc-100mm"),
        "sensor_type": SENSOR_TYPE,
        "indenter": INDENTER,
        "reference": np.random.default_rng(5).standard_normal((16, 16)),
        "current_A": 4e-4,
        "scale": 7.24,
        "reconstruction": reconstruction(),
        "response": Response.INCREASE,
        "noise_floor": 0.006,
        "mask": 0.85,
        "baseline": (
            BaselineConductance("L0", 0.0, 0.0, 1.01, 0.02, 3),
            BaselineConductance("L1", 30.0, 0.0, None, None, 0, "no blob"),
        ),
        "against_stress": replace(MATERIAL.against_stress, covariance=-1.5e-8),
        "against_strain": MATERIAL.against_strain,
        "assumed": ("α against stress", "β against stress"),
        "settling": (
            SettlingSummary("conductance", True, 31.0, 2.0, 9, 0, 1),
            SettlingSummary("stress", False, None, None, 0, 0, 2),
        ),
        "overlap_bands": (OverlapBand("likely poor", 0.0, 50.0), OverlapBand("ok", 50.0, 100.0)),
        "overlap_threshold": 50.0,
        "validity": Validity((0.9, 5.3), (0.05, 0.3), None, 30.0, ("one strain only",)),
        "simulated": ("the sheet",),
        "relaxations": RELAXATIONS,
        "size_ratio": (1 / 3, 3.0),
        "noise_figure": 1.17,
    }
    return stamp(Calibration(**(values | changes)))
