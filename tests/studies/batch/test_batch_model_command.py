"""``cbsr-qa batch model`` on stored batches: what it learns from, names, refuses, prints and writes."""

import json
import sqlite3
from dataclasses import replace

import numpy as np
import pytest
import stored_lots
from batches import draw_batch, draw_field, draw_map, place_sunflower, press
from filled_databases import filled
from stored_lots import store_run

from cbsr_qa.calibration.batch.kept import make_prior
from cbsr_qa.config.merging import read_model_file
from cbsr_qa.domain.errors import NumericsError, RefusedError
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.measurement import Measurement, Verdict
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.store.opening import open_store
from cbsr_qa.studies.batch import study
from cbsr_qa.studies.batch.sensors import StoredSensor

PASSED = Verdict(Outcome.PASS, "in the test")
MEASURED = (Measurement("drift", 0.1, "%/min"),)
SETTLING = ("conductance", True)
MODEL = "a" * 64


def run_of(number, **options):
    return f"B-{number:02d}", MEASURED, {"batch": "41", "day": number, "verdict": PASSED, **options}


@pytest.fixture
def observed(monkeypatch):
    """Runs are not imaged: loads and settling times are drawn; sensor ``odd`` is of another batch."""
    random = np.random.default_rng(12)
    sensors, _ = draw_batch(random, 0.9, sensors=12)
    strange = press(random, draw_map(random, draw_field(random), 0.9), place_sunflower(16))

    class Observed:
        odd = silent = None
        with_prior = ()

        def __call__(self, store, record):
            number = int(record.identity.sensor.serial[2:])
            if number == self.silent:
                raise NumericsError("no load was pressed alone")
            loads = strange if number == self.odd else sensors[number]
            settling = {SETTLING: 20.0 + number + random.standard_normal() / 10}
            return StoredSensor(record, loads, settling, None, MODEL if number in self.with_prior else "")

    observe = Observed()
    monkeypatch.setattr(study, "observe_sensor", observe)
    return observe


@pytest.fixture
def model(printed):
    return lambda database, *options: printed("batch", "model", "--batch", "41", "--database", database, *options)


@pytest.fixture
def refused(run_in_words):
    def run(database, *options):
        code, out, err = run_in_words("batch", "model", "--batch", "41", "--database", database, *options)
        assert (code, out) == (2, "")
        return err

    return run


@pytest.fixture
def database(tmp_path):
    path = tmp_path / "runs.db"
    filled(path, [run_of(number) for number in range(6)])
    return path


def test_document_says_what_is_shared_and_what_it_rests_on(database, observed, model):
    found = model(database)
    assert set(found["rho"]) == {"value", "low", "high", "mean"}
    assert 0 <= found["rho"]["low"] <= found["rho"]["value"] <= found["rho"]["high"] <= 1
    assert [sensor["serial"] for sensor in found["sensors"]] == [f"B-{number:02d}" for number in range(6)]
    assert all(len(sensor["chain_head"]) == 64 for sensor in found["sensors"])
    assert (found["batch"], found["sensor_type"], found["material"]) == ("41", "disc-100mm", "cbsr-8wt")
    assert len(found["digest"]) == 64
    errors = [expected["error"] for expected in found["expected"]]
    assert errors == sorted(errors, reverse=True)
    assert not any(sensor["stands_out"] for sensor in found["sensors"])


def test_a_run_that_says_nothing_of_the_response_is_left_out_with_the_reason(database, observed, model, refused):
    observed.silent = 3
    found = model(database)
    assert len(found["sensors"]) == 5
    assert [(one["serial"], one["why"]) for one in found["left_out"]] == [("B-03", "no load was pressed alone")]
    assert "4 sensors" in (said := refused(database, "--without", "B-00"))
    assert "B-03 (no load was pressed alone)" in said


@pytest.mark.rest
def test_same_runs_give_the_same_digest_and_other_runs_another(database, observed, model):
    assert model(database)["digest"] == model(database)["digest"] != model(database, "--without", "B-05")["digest"]


@pytest.mark.rest
def test_drift_over_the_batch_is_found(database, observed, model):
    (settling,) = [one for one in model(database)["quantities"] if one["unit"] == "s"]
    assert settling["drift_low"] < 1.0 < settling["drift_high"]
    assert settling["drift_p"] < 0.001


@pytest.mark.rest
def test_a_sensor_of_another_batch_stands_out(database, observed, model, run_in_words):
    filled(database, [run_of(number) for number in (6, 7, 8)])
    observed.odd = 7
    found = model(database)
    assert [sensor["serial"] for sensor in found["sensors"] if sensor["stands_out"]] == ["B-07"]
    without = model(database, "--without", "B-07")
    assert without["rho"]["value"] > found["rho"]["value"]
    assert [(one["serial"], one["why"]) for one in without["left_out"]] == [("B-07", "left out by --without")]
    code, out, _ = run_in_words("batch", "model", "--batch", "41", "--database", database)
    assert code == 0
    assert "not like the others: B-07" in out


def test_runs_that_do_not_count_are_named(database, observed, model):
    later = filled(
        database,
        [
            run_of(0, day=9),
            run_of(6, verdict=Verdict(Outcome.FAIL, "too much")),
            run_of(7, end=EndReason.ABORTED),
            run_of(8),
        ],
    )
    with sqlite3.connect(database) as connection:
        connection.execute("DELETE FROM runs_begun")
        connection.execute("DELETE FROM run_links WHERE run = ?", [later[3]])
        connection.execute(
            "UPDATE runs SET chain = NULL, before_run = NULL, before_link = NULL, before_sha256 = NULL WHERE run = ?",
            [later[3]],
        )
    found = model(database)
    assert len(found["sensors"]) == 6
    reasons = {one["serial"]: one["why"] for one in found["left_out"]}
    assert reasons == {
        "B-00": "a later run of the sensor counts",
        "B-06": "its verdict is fail",
        "B-07": "it was aborted",
        "B-08": "it is not under a chain: nobody would notice if it were changed",
    }
    assert later[0] in {sensor["run"] for sensor in found["sensors"]}


def test_runs_that_had_the_batch_as_prior_are_named(database, observed, model, run_in_words):
    observed.with_prior = (1, 4)
    found = model(database)
    assert [sensor["prior"] for sensor in found["sensors"]] == ["", MODEL, "", "", MODEL, ""]
    _, out, _ = run_in_words("batch", "model", "--batch", "41", "--database", database)
    assert "2 runs took an earlier model of the batch as prior (B-01, B-04): only their presses count" in out


def test_a_batch_whose_relaxation_nobody_measured_is_refused(database, observed, refused):
    observed.with_prior = range(6)
    assert "every run took how loads relax from an earlier model of the batch" in refused(database)


def test_four_sensors_are_refused_with_those_left_out(tmp_path, observed, refused):
    database = tmp_path / "runs.db"
    runs = [run_of(number) for number in range(4)]
    filled(database, [*runs, run_of(4, verdict=Verdict(Outcome.FAIL, "too much"))])
    said = refused(database)
    assert "4 sensors of batch '41' can be learned from; 5 are needed" in said
    assert "B-04 (its verdict is fail)" in said


def test_two_materials_are_refused_until_one_is_named(database, observed, refused, model, monkeypatch):
    other = {**stored_lots.SETTING, "material": replace(stored_lots.SETTING["material"], name="cbsr-9wt")}
    monkeypatch.setattr(stored_lots, "SETTING", other)
    with open_store(f"sqlite:///{database}") as store:
        store_run(store, "B-06", MEASURED, batch="41", day=9, verdict=PASSED)
    said = refused(database)
    assert "2 materials: 'cbsr-8wt' (6 runs), 'cbsr-9wt' (1 run)" in said
    assert "--material" in said
    found = model(database, "--material", "cbsr-8wt")
    assert [one["why"] for one in found["left_out"]] == ["it is of material cbsr-9wt"]


def test_a_material_of_the_same_name_with_another_line_is_refused(database, observed, refused, monkeypatch):
    material = stored_lots.SETTING["material"]
    line = material.against_stress
    steeper = replace(line, slope=replace(line.slope, value=2 * line.slope.value))
    other = {**stored_lots.SETTING, "material": replace(material, against_stress=steeper)}
    monkeypatch.setattr(stored_lots, "SETTING", other)
    with open_store(f"sqlite:///{database}") as store:
        store_run(store, "B-06", MEASURED, batch="41", day=9, verdict=PASSED)
    assert "line of the material of run" in refused(database)


def test_an_unknown_batch_is_refused_with_the_known_ones(database, observed, run_in_words):
    code, _, err = run_in_words("batch", "model", "--batch", "14", "--database", database)
    assert code == 2
    assert "no stored run is of batch '14'" in err


@pytest.mark.rest
def test_page_and_file_are_written_and_the_file_is_the_model(database, observed, model, tmp_path):
    page, file = tmp_path / "page.html", tmp_path / "model.json"
    found = model(database, "--output", page, "--to", file)
    text = page.read_text()
    assert "<svg" in text
    assert "How to read this page" in text
    kept = read_model_file(file)
    assert kept.digest == found["digest"]
    mean, variance = make_prior(kept).predict(np.zeros((1, 2)))
    assert np.isfinite(mean).all()
    assert (variance > 0).all()
    changed = tmp_path / "changed.json"
    content = json.loads(file.read_text())
    content["sensors"][0]["log_response"][0] += 0.1
    changed.write_text(json.dumps(content))
    with pytest.raises(RefusedError, match="was changed"):
        read_model_file(changed)


def test_a_file_is_never_written_over(database, observed, refused, tmp_path):
    file = tmp_path / "model.json"
    file.write_text("mine")
    assert "exists already" in refused(database, "--to", file)
    assert file.read_text() == "mine"
