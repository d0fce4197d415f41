"""Golden lots in a database: runs of sensors with measurements whose distribution is known."""

import hashlib
import json
from contextlib import contextmanager
from dataclasses import replace
from datetime import timedelta
from unittest.mock import patch

import numpy as np
from stored_runs import SETTING, short_run

from cbsr_qa.config.serials import read_parts
from cbsr_qa.domain.plan.limits import Limit
from cbsr_qa.domain.results.measurement import Measurement, decide
from cbsr_qa.domain.results.run_result import RunResult
from cbsr_qa.domain.run.events import PhaseFinished, RunEnded, RunStarted
from cbsr_qa.domain.run.run import RunRecord
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.store.results import analyses

PHASE = "nine locations"
LIMITS = {
    "centre_of_mass_error": Limit("centre_of_mass_error", "mm", None, 6.5, 1.5, PHASE),
    "drift": Limit("drift", "%/min", -0.5, 0.5, 0.1),
}


def measured(random, sensor, *, locations=9):
    """What one run of a sensor measures: nine errors, a drift that repeats within 0.01, and two without a limit.

    Parameters
    ----------
    sensor : (3,) what this sensor is; the rest is the run.
    """
    errors = 2.0 + 0.2 * sensor[0] + 0.2 * random.standard_normal(locations)
    drift = 0.05 * sensor[1] + 0.01 * random.standard_normal()
    return (
        *(
            Measurement("centre_of_mass_error", float(x), "mm", 0.02, PHASE, f"L{k}", 0, load=k, strain=0.2)
            for k, x in enumerate(errors)
        ),
        Measurement("drift", float(drift), "%/min"),
        Measurement("noise_floor", float(0.006 * np.exp(0.2 * sensor[2])), "1"),
        Measurement("missed_loads", 0.0, "1"),
    )


def judged(measurements, limits=None):
    limits = LIMITS if limits is None else limits
    return tuple(m.judge(limits[m.name]) if m.name in limits else m for m in measurements)


@contextmanager
def unchecked_results():
    """Store results without checking them and reading them back: half of the time."""

    def skip(*_):
        """Do nothing: to make a mock takes longer than to store a phase."""

    unread = (patch.object(analyses, "check_unless_checked", skip), patch.object(analyses, "look_afresh", skip))
    with unread[0], unread[1], patch.object(analyses.Analyses, "load", skip):
        yield


def store_run(repository, serial, measurements, *, batch="golden", recipe="short", day=0, software=None, **changes):
    """Store a finished run with what it measured; returns its name.

    It has one phase without loads, and is neither checked nor read back.
    """
    run = repository.new_id()
    recipe_tables = {"recipe": {"name": recipe}, "limits": changes.get("limits", []), **changes.get("tables", {})}
    configuration = json.dumps({"layout": 1, "seed": day, "recipe": recipe_tables, **changes.get("content", {})})
    started, phase, *events = short_run(run, serial)
    finished = [event for event in events if event == PhaseFinished(0, 155.0)]
    events = [phase, *changes.get("decided", ()), *finished, events[-1]]
    identity = replace(
        started.identity,
        sensor=replace(started.identity.sensor, batch=batch),
        recipe=recipe,
        station=changes.get("station", started.identity.station),
        operator=changes.get("operator", started.identity.operator),
        parts=read_parts(changes.get("parts", ())),
        configuration_digest=hashlib.sha256(configuration.encode()).hexdigest(),
        started_at=started.identity.started_at + timedelta(days=day),
    )
    if "end" in changes:
        events = [*events[:-1], RunEnded(changes["end"], "by the operator", 201.0, ())]
    journal = repository.open_journal(configuration=configuration, **SETTING)
    for event in (RunStarted(identity), *events):
        journal(event)
    if changes.get("end", EndReason.FINISHED) is EndReason.FINISHED:
        verdict = changes.get("verdict", decide(measurements))
        record = RunRecord(identity, **SETTING, phases=(), end=EndReason.FINISHED)
        result = RunResult(record, None, measurements, verdict, None, "not asked for")
        with unchecked_results():
            repository.analyses.save(result, software=software or [("cbsr-qa", "0.1.0"), ("numpy", "2.0")])
    return run


def lot_runs(sensors=12, repeats=6, seed=0):
    """Yield the runs of a lot as ``filled`` takes them: S-01, S-02, … once each, the first ones a second time."""
    random = np.random.default_rng(seed)
    for number in range(sensors):
        sensor = random.standard_normal(3)
        for again in range(2 if number < repeats else 1):
            yield f"S-{number + 1:02d}", judged(measured(random, sensor)), {"day": again}
