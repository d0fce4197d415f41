"""How calibrations of runs were made: told by what the runs were and did, not by the names of their recipes."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from calibration_samples import sample_calibration
from compared_fleets import compared, json_of, run_of
from filled_databases import filled
from stored_lots import judged, measured

from cbsr_qa.calibration.file.hdf5 import write_calibration
from cbsr_qa.domain.results.calibration import BatchUse
from cbsr_qa.domain.results.fleet import CalibrationWay, RunSelection
from cbsr_qa.domain.run.run import PressDecided
from cbsr_qa.store.opening import open_store
from cbsr_qa.studies.compare.terms import By
from cbsr_qa.studies.gauge.request import GaugeRequest
from cbsr_qa.studies.gauge.study import gauge
from cbsr_qa.studies.selection import add_ways, count_ways

MODEL, OTHER = "a" * 64, "b" * 64
DECIDED = PressDecided(0, 0, 0, "A0", 1.0, 2.0, None, None, None, "start", 11.0)
#: Options of ``store_run`` by what the run was.
FIXED = {"tables": {"recipe": {"name": "short", "calibrate_phases": ["grid"]}}}
ADAPTIVE = {**FIXED, "decided": (DECIDED,)}
ON_ITS_BATCH = {**ADAPTIVE, "content": {"batch_model": {"digest": MODEL}}}
ON_ANOTHER = {**ADAPTIVE, "content": {"batch_model": {"digest": OTHER}}}


def store(tmp_path, kinds):
    """A database of four runs of each kind, at two stations."""
    random = np.random.default_rng(1)
    runs = [
        (f"S-{number}", judged(measured(random, random.standard_normal(3))),
         {"batch": "41", "station": station, "day": number, **options})
        for number, options in enumerate(kinds)
        for station in ("A", "B", "A", "B")
    ]  # fmt: skip
    filled(tmp_path / "runs.db", runs)
    return f"sqlite:///{tmp_path / 'runs.db'}"


def ways_of(url):
    with open_store(url, create=False) as opened:
        return [run.way for run in add_ways(opened, opened.fleet.read_lines())][::4]


def test_a_way_is_read_from_what_the_run_was_and_did(tmp_path):
    url = store(tmp_path, [{}, FIXED, ADAPTIVE, ON_ITS_BATCH, ON_ANOTHER])
    assert ways_of(url) == [
        CalibrationWay("no calibration"),
        CalibrationWay("fixed places"),
        CalibrationWay("adaptive"),
        CalibrationWay("adaptive", MODEL),
        CalibrationWay("adaptive", OTHER),
    ]


def renamed(options, name):
    return {**options, "recipe": name, "tables": {"recipe": {**options["tables"]["recipe"], "name": name}}}


@pytest.mark.parametrize(
    ("kinds", "words"),
    [
        ([FIXED, ADAPTIVE], "adaptive (4 runs); fixed places (4 runs)"),
        ([ADAPTIVE, ON_ITS_BATCH], f"adaptive (4 runs); adaptive with batch model {MODEL[:12]} as prior (4 runs)"),
        ([ON_ITS_BATCH, ON_ANOTHER], f"{MODEL[:12]} as prior (4 runs); adaptive with batch model {OTHER[:12]}"),
    ],
)  # fmt: skip
def test_ways_under_one_name_are_told_apart(tmp_path, kinds, words):
    url = store(tmp_path, kinds)
    made = json_of(compared(url, By.STATION))
    (caution,) = [warning for warning in made["warnings"] if "ways to calibrate" in warning]
    assert words in caution
    assert [counted["runs"] for counted in made["ways"]] == [4, 4]
    studied = gauge(GaugeRequest(RunSelection(recipe="short")), database=url)
    assert any("calibrations were made in several ways" in note and words in note for note in studied.notes)
    assert [counted.runs for counted in studied.ways] == [4, 4]


def test_one_way_under_two_names_is_one(tmp_path):
    url = store(tmp_path, [ON_ITS_BATCH, renamed(ON_ITS_BATCH, "other")])
    made = json_of(compared(url, By.STATION))
    assert not [warning for warning in made["warnings"] if "ways to calibrate" in warning]
    assert made["ways"] == [{"way": {"places": "adaptive", "batch_model": MODEL, "unlike": False}, "runs": 8}]


@pytest.mark.parametrize("alike", [True, False])
def test_a_sensor_unlike_its_batch_was_calibrated_by_its_own_loads(alike, tmp_path):
    sample = sample_calibration()
    force = replace(sample.force, batch=BatchUse(MODEL, alike, 0.01, 0.0))
    digest = write_calibration(tmp_path / "one.h5", replace(sample, force=force))
    way = CalibrationWay("adaptive", MODEL)
    stored = SimpleNamespace(
        fleet=SimpleNamespace(read_ways=lambda runs: {"run-0001": (way, "issued")}),
        calibrations=SimpleNamespace(load_file=lambda name: ((tmp_path / "one.h5").read_bytes(), digest)),
    )
    (run,) = add_ways(stored, [run_of(1, "41")])
    assert run.way == replace(way, unlike=not alike)
    assert ("which the sensor is not like" in run.way.words) == (not alike)


def test_runs_whose_way_nobody_asked_for_are_not_counted():
    assert count_ways([run_of(number, "41") for number in range(3)]) == ()
