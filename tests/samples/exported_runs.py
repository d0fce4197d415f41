"""A database of five short runs whose tables, frames and outcomes are exported."""

import json
from dataclasses import replace

import numpy as np
from made_once import made_once
from stored_runs import SENSOR_TYPE, identity, journalled, load, record, short_run

from cbsr_qa.domain.plan.limits import Limit, Outcome
from cbsr_qa.domain.plan.steps import Press, Role
from cbsr_qa.domain.readings.frames import FrameBlock, ReadingFlag, VoltageUnit
from cbsr_qa.domain.readings.loads import EasedStrain
from cbsr_qa.domain.results.measurement import Measurement, decide
from cbsr_qa.domain.results.run_result import RunResult
from cbsr_qa.domain.run.events import (
    FramesTaken,
    LoadFinished,
    PhaseFinished,
    PhaseStarted,
    RunEnded,
    RunStarted,
    StepStarted,
)
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.store.opening import open_store

GRID = "nine locations"
ERROR = Limit("centre_of_mass_error", "mm", None, 6.5, 1.5, GRID)
DRIFT = Limit("drift", "%/min", -0.5, 0.5, 0.1)


def measured(error_mm, drift):
    """Two judged measurements, and one without a value whose words a spreadsheet would work out."""
    return (
        Measurement(
            "centre_of_mass_error", error_mm, "mm", 0.02, GRID, "L0", 0, how="blob", load=0, strain=0.2
        ).judge(ERROR),
        Measurement("drift", drift, "%/min", how="no frame" if drift is None else "").judge(DRIFT),
        Measurement("zero_return", None, "1", how='=HYPERLINK("x")'),
    )


def five_runs():
    """Return the address of a database, to be read only, and its runs by name.

    They are passed, failed, unmeasured, overridden (failed, to a pass) and aborted.
    """
    kept = made_once("five exported runs", _store_five)
    return f"sqlite:///{kept / 'runs.db'}", json.loads((kept / "names.json").read_text())


def _store_five(folder):
    names = {}
    with open_store(f"sqlite:///{folder / 'runs.db'}", durable=False) as store:
        for number, (name, values) in enumerate(
            {
                "passed": (5.5, -0.25),
                "failed": (7.25, 0.1),
                "unmeasured": (2.0, None),
                "overridden": (9.0, 0.1),
            }.items()
        ):
            run = names[name] = store.new_id()
            journalled(store, short_run(run, f"S-{number}"))
            results = measured(*values)
            store.analyses.save(
                RunResult(store.runs.load(run), None, results, decide(results), None, "not asked for")
            )
        store.changes.override_verdict(names["overridden"], Outcome.PASS, operator="Ada", why="the head was bent")
        run = names["aborted"] = store.new_id()
        started, *events, _ = short_run(run, "S-4")
        of_others = replace(started.identity, station="bench-β", operator="@SUM(1)", recipe="long")
        events = [RunStarted(of_others), *events, RunEnded(EndReason.ABORTED, "by\x02 the operator", 200.0, ())]
        journalled(store, events)
    (folder / "names.json").write_text(json.dumps(names))


def obeying_ohm(seed=0, count=6):
    """Frames (n, drives, measures) [V at 0.4 mA] of random sheets, and their transfer impedances [Ω]."""
    pattern, random = SENSOR_TYPE.pattern, np.random.default_rng(seed)
    half = random.standard_normal((count, pattern.electrode_count, pattern.electrode_count))
    impedance_ohm = half @ half.transpose(0, 2, 1)
    currents = 4e-4 * pattern.drive_currents()
    return currents.T @ impedance_ohm @ pattern.measure_matrix(), impedance_ohm


def store_pressed(url, *, missing=True):
    """Store a run of one phase with a press that was eased; returns its name and the frames' impedances."""
    voltages, impedance_ohm = obeying_ohm()
    flags = np.zeros(voltages.shape, dtype=np.uint8)
    if missing:
        flags[1, 2, 3] = ReadingFlag.MISSING | ReadingFlag.SATURATED
        voltages[1, 2, 3] = 0.0
    # before the press, during it, at 0.2, on the way to 0.1, at 0.1, at rest
    time_s = np.array([29.0, 30.5, 31.5, 40.5, 50.0, 100.0])
    frames = FrameBlock(time_s, voltages, flags, VoltageUnit.VOLT, 4e-4)
    eased = replace(record(0, 30.0), load=load(), eased=(EasedStrain(0.1, 40.0, 41.0),))
    with open_store(url) as store:
        run = store.new_id()
        journalled(
            store,
            [
                RunStarted(identity(run)),
                PhaseStarted(0, GRID, "location-grid", 0.5, Role.GRID),
                StepStarted(0, 0, Press(load()), 28.0, 200.0),
                FramesTaken(0, frames),
                LoadFinished(0, eased),
                PhaseFinished(0, 160.0),
                RunEnded(EndReason.FINISHED, "", 161.0, ()),
            ],
        )
    return run, impedance_ohm
