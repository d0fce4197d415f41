"""A fleet of two batches on two stations, and what is found by comparing them."""

from dataclasses import replace
from datetime import UTC, datetime
from html import unescape

import numpy as np
from filled_databases import filled
from stored_lots import judged, measured

from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.fleet import FleetTable, MetricKey, RunLine, RunSelection, ValueKind
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.report.document import json_document
from cbsr_qa.report.render import render_sections
from cbsr_qa.studies.compare.comparison import compare_groups
from cbsr_qa.studies.compare.report import compare_outcome
from cbsr_qa.studies.compare.terms import By, Terms

NOW = datetime(2026, 12, 24, tzinfo=UTC)
ERROR = "centre_of_mass_error"
BATCH_MM, STATION_MM = 0.5, 0.8


def moved(measurements, mm):
    return tuple(replace(m, value=m.value + mm) if m.name == ERROR else m for m in measurements)


def fleet(url, *, alone=False, sensors=24, both=8, **changes):
    """Two batches on two stations: 42 is BATCH_MM above 41, B reads STATION_MM above A.

    Parameters
    ----------
    alone : each batch on a station of its own; else every third sensor of either is at home on B.
    both : sensors that run on both stations.
    """
    random = np.random.default_rng(8)
    runs = []
    for number in range(sensors):
        batch = ("41", "42")[number % 2]
        home = ("A", "B")[number % 2 if alone else number % 3 == 0]
        sensor = random.standard_normal(3)
        for station in ("A", "B") if number < both and not alone else (home,):
            mm = BATCH_MM * (batch == "42") + STATION_MM * (station == "B")
            values = judged(moved(measured(random, sensor), mm))
            runs.append((f"S-{number:02d}", values, {"batch": batch, "station": station, **changes}))
    filled(url.removeprefix("sqlite:///"), runs)


def run_of(number, batch, station="A", began=NOW, **changes):
    """A finished and analysed run of a sensor of its own, without a database."""
    run = RunLine(
        run=f"run-{number:04d}",
        serial=f"S-{number:03d}",
        batch=batch,
        material="cbsr",
        station=station,
        recipe="short",
        started_at=began,
        made_at=began,
        end=EndReason.FINISHED,
        outcome=Outcome.PASS,
        software=(("cbsr-qa", "1.0"),),
        simulated=(),
    )
    return replace(run, **changes)


def table_of(runs, values, names=("gap",)):
    """Runs with one value of each metric: (R,) or (R, metrics)."""
    values = np.asarray(values, dtype=float).reshape(len(runs), len(names))
    kinds = tuple(ValueKind(MetricKey(name), "mm", "", None, None) for name in names)
    run, kind = np.divmod(np.arange(values.size, dtype=np.int32), np.int32(len(names)))
    return FleetTable(tuple(runs), kinds, run, kind, values.ravel(), np.zeros(values.size, np.uint8))


def compared(url, by=By.BATCH, choice=None, **terms):
    return compare_outcome(compare_groups(choice or RunSelection(), Terms(by, **terms), database=url, now=NOW))


def json_of(made):
    return json_document(made.result)


def page_of(made):
    return unescape(render_sections(made.page, made.sections))


def metric(made, name=ERROR, group=None):
    return next(m for m in json_of(made)["metrics"] if m["name"] == name and group in (None, m["group"]))
