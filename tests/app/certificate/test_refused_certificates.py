"""What cannot be certified is named, and nothing is issued."""

import json
import re
from datetime import timedelta

import pytest
from altered_runs import fill
from certificates import laboratory_table
from certified_runs import STANDARDS, write_recipe, write_station
from synced import run_of

from cbsr_qa.app.certificate.compose import (
    compose_certificate,
)
from cbsr_qa.app.certificate.request import CertificateRequest
from cbsr_qa.cli.main import run_guarded
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.store.opening import open_store

REFUSED = {
    "no run": (None, ("S-9", "--to", "out"), "there is no run and no sensor 'S-9'"),
    "a broken chain": ("update loads set x_mm = x_mm + 1", ("S-1", "--to", "out"), "loads .* was changed"),
    "a changed frame": ("update frame_blocks set voltages = zeroblob(9)", ("S-1", "--to", "out"), "frame"),
    "no chain": ("update runs set chain = null", ("S-1", "--to", "out"), "states no chain"),
    "no customer's name": (None, ("S-1", "--to", "out", "--customer", "a\nb"), "n' is not allowed"),
    "no reason": (None, ("S-1", "--to", "out", "--replaces", "X"), "--replaces and --reason are given together"),
    "nothing to replace": (
        None,
        ("S-1", "--to", "out", "--replaces", "SSW-1", "--reason", "x"),
        "there is no certificate 'SSW-1'",
    ),
    "a file for a folder": (None, ("S-1", "--to", "station.toml"), "exists, and is not a folder"),
    "no key": (None, ("S-1", "--to", "out", "--key", "none.key"), "key none.key cannot be read"),
    "no laboratory": (None, ("S-1", "--to", "out", "--laboratory", "recipe.toml"), "not a certificate settings file"),
    "odd months": (
        None,
        ("S-1", "--to", "out", "--validity-months", "0"),
        "^--validity-months has 1 problem.*certificate.validity_months is 0; it must be a whole number from 1 to 12",
    ),
    "a validity beyond the year of U in use": (
        None,
        ("S-1", "--to", "out", "--validity-months", "13"),
        "certificate.validity_months is 13; it must be a whole number from 1 to 12",
    ),
    "a rule without requirement": (
        None,
        ("S-1", "--to", "out", "--decision", ""),
        "^--decision has 1 problem.*certificate.decision",
    ),
    "a requirement and none": (
        None,
        ("S-1", "--to", "out", "--no-max-error", "--decision", "simple"),
        "--no-max-error with a maximum permissible error or --decision",
    ),
    "neither sensor nor batch": (None, ("--to", "out"), "give SERIAL or --batch"),
    "no batch": (None, ("--batch", "B9", "--to", "out"), "no stored run is of batch 'B9'"),
}


@pytest.mark.rest
@pytest.mark.parametrize(("statement", "words", "said"), REFUSED.values(), ids=REFUSED)
def test_what_cannot_be_certified_is_named_and_nothing_is_issued(place, statement, words, said):
    if statement is not None:
        place.change(statement)
    refused = place.certify(*words, code=2)["refused"]
    assert re.search(said, " ".join(refused["reason"].split())), refused
    if statement is None:
        place.check_nothing_issued()
    assert not (place.folder / "out").exists()


@pytest.mark.rest
@pytest.mark.parametrize("letter", ["\\u0007", "\\u202E", "\\u200B"])
def test_texts_that_cannot_be_printed_are_named(place, letter, capsys):
    """XML has no control characters, and others turn or hide what is signed."""
    file = place.folder / "laboratory.toml"
    file.write_text(laboratory_table().replace("Soft Sensor Works", f"Soft{letter}Sensor"))
    assert run_guarded(["certificate", "S-1", "--to", "out", "--laboratory", str(file), *place.at]) == 2
    assert "certificate.laboratory" in (said := capsys.readouterr().err)
    assert "printed, in one line" in " ".join(said.split())
    place.check_nothing_issued()


@pytest.mark.rest
def test_a_country_that_iso_does_not_know_is_named(place):
    (place.folder / "laboratory.toml").write_text(laboratory_table(country="UK"))
    refused = place.certify("S-1", "--to", "out", "--laboratory", "laboratory.toml", code=2)["refused"]
    assert refused["reason"] == "certificate.country is 'UK', no code of ISO 3166-1"
    assert '"GB" is the United Kingdom' in refused["remedy"]
    place.check_nothing_issued()


@pytest.mark.rest
def test_a_folder_below_a_file_is_named(place, capsys):
    (place.folder / "file").write_text("")
    assert run_guarded(["certificate", "S-1", "--to", "file/out", *place.at]) == 2
    assert "file/out" in capsys.readouterr().err
    with open_store(f"sqlite:///{place.database}") as store:
        assert store.certificates.list_all() == ()


@pytest.mark.rest
def test_a_destination_that_exists_is_refused(place):
    with open_store(f"sqlite:///{place.database}") as store:
        run = store.runs.resolve("S-1")
    (place.folder / "out").mkdir()
    (place.folder / "out" / f"SSW-{run}.xml").write_text("mine")
    refused = place.certify("S-1", "--to", "out", code=2)["refused"]
    assert f"exists already, and the database has no certificate SSW-{run}" in refused["reason"]
    (told,) = place.certify("--batch", "B7", "--to", "out", code=1)["refused"]
    assert told["remedy"] == refused["remedy"]
    assert f"remove out/SSW-{run}.*; else test the sensor again" in refused["remedy"]
    assert [path.name for path in (place.folder / "out").iterdir()] == [f"SSW-{run}.xml"]


@pytest.mark.rest
def test_a_certificate_is_not_issued_before_its_calibration(place):
    with open_store(f"sqlite:///{place.database}") as store:
        run = store.runs.resolve("S-1")
        (analysis,) = store.analyses.load(run)
        early = analysis.analysed_at - timedelta(days=30)
        said = f"it is {early.date()}, and the calibration was made on {analysis.analysed_at.date()}"
        with pytest.raises(RefusedError, match=f"by the clock of this computer {said}"):
            compose_certificate(store, run, CertificateRequest(place.folder / "out"), early)


@pytest.mark.rest
def test_a_sensor_that_failed_is_refused_also_by_a_person(place, capsys):
    with open_store(f"sqlite:///{place.database}") as store:
        run = store.runs.resolve("S-1")
    words = ("verdict", "override", run, "--outcome", "fail", "--by", "Ada", "--why", "scratched")
    assert run_guarded([*words, "--database", str(place.database)]) == 0
    capsys.readouterr()
    refused = place.certify("S-1", "--to", "out", code=2)["refused"]["reason"]
    assert refused == f"sensor S-1 is not certified: the verdict of run {run} is fail: overridden by Ada: scratched"
    place.check_nothing_issued()


def _run_and_refuse(folder, serial, monkeypatch, capsys):
    """Test a sensor with the files in a folder, request its certificate, and return why it was refused."""
    monkeypatch.setenv("CBSR_QA_VAR", str(folder / "var"))
    monkeypatch.chdir(folder)
    run = ("run", "--station", "station.toml", "--recipe", "recipe.toml", "--serial", serial, "--operator", "Ada")
    run_guarded([*run, "--json"])
    capsys.readouterr()
    assert run_guarded(["certificate", serial, "--to", "out", "--json"]) == 2
    assert not (folder / "out").exists()
    return json.loads(capsys.readouterr().out)["refused"]["reason"]


@pytest.mark.rest
def test_a_standard_that_was_overdue_is_named(tmp_path, monkeypatch, capsys):
    write_recipe(tmp_path / "recipe.toml")
    overdue = STANDARDS.replace("2099-03-31", "2026-02-28")
    write_station(tmp_path / "station.toml", standards=overdue)
    said = _run_and_refuse(tmp_path, "S-1", monkeypatch, capsys)
    assert "the calibration of the load cell (certificate K-7) was due on 2026-02-28" in said


@pytest.mark.rest
def test_an_instrument_that_was_overdue_is_named(tmp_path, monkeypatch, capsys):
    """The gate of the shipped station only warns of it."""
    write_recipe(tmp_path / "recipe.toml")
    write_station(tmp_path / "station.toml")
    station = (tmp_path / "station.toml").read_text()
    due = '[instruments.bench]\ncalibration_due = "2026-02-28"\n'
    (tmp_path / "station.toml").write_text(station.replace("[instruments.bench]\n", due))
    said = _run_and_refuse(tmp_path, "S-1", monkeypatch, capsys)
    assert "the calibration of bench (simulated-bench) was due on 2026-02-28" in said


@pytest.mark.rest
def test_a_sensor_that_failed_is_named(tmp_path, monkeypatch, capsys):
    write_recipe(tmp_path / "recipe.toml", upper_N=1e-6)
    write_station(tmp_path / "station.toml")
    said = _run_and_refuse(tmp_path, "S-1", monkeypatch, capsys)
    assert re.match("sensor S-1 is not certified: the verdict of run .* is fail: force error", said)


def test_a_run_without_a_calibration_or_a_result_is_named(tmp_path, monkeypatch, capsys):
    database = tmp_path / "runs.db"
    fill(f"sqlite:///{database}")
    with open_store(f"sqlite:///{database}") as store:
        first = store.runs.find("S-1")[-1].run
        unfinished = run_of(store, "S-2")
    for name, said in ((first, "it issued no calibration"), (unfinished, "it was finished and has no result")):
        assert run_guarded(["certificate", name, "--to", str(tmp_path / "out"), "--database", str(database)]) == 2
        assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
