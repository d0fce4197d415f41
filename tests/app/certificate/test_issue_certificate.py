"""Certificates of a simulated sensor are issued, from the command line."""

import re
from dataclasses import replace
from datetime import UTC, date, datetime
from types import SimpleNamespace

import pytest
from certificates import HOSTILE, laboratory_table
from certified_runs import write_station

from cbsr_qa.app.certificate.compose import (
    add_months,
    choose_places,
    compose_certificate,
    list_deviations,
    number_certificate,
)
from cbsr_qa.app.certificate.request import CertificateRequest
from cbsr_qa.calibration.file.keys import new_key
from cbsr_qa.cli.main import run_guarded
from cbsr_qa.config.loader import load_certificate_settings, load_station
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.plan.gate import GateCheck, GatePolicy
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.run.gate import GateAnswer, GateOutcome, gate_warnings
from cbsr_qa.store.opening import open_store


@pytest.mark.rest
def test_a_certificate_is_issued_by_the_contract_and_holds(place):
    made = place.certify("S-1", "--to", "out", "--customer", "Robots plc")
    assert list(made) == ["number", "html", "dcc", "statement", "force", "standards"]
    assert re.fullmatch(r"SSW-[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12}", made["number"])
    assert "of 5 checked loads" in made["statement"]
    on_the_day = ("place_mm", "force_N", "U_N", "k", "dof", "not_stated")
    in_use = ("U_in_use_N", "k_in_use", "dof_in_use", "not_stated_in_use")
    assert {tuple(one) for one in made["force"]} == {(*on_the_day, *in_use)}
    assert all(one["U_in_use_N"] >= one["U_N"] > 0 and one["k"] >= 1.9599 for one in made["force"])
    assert all("drift of the load cell" in one["not_stated"] for one in made["force"])
    assert all("ageing of the sensor" in one["not_stated_in_use"] for one in made["force"])
    assert made["standards"][:2] == [
        {"role": "load_cell", "number": "K-7", "due": "2099-03-31", "stated": True},
        {"role": "indenter", "number": None, "due": None, "stated": False},
    ]
    for file in (made["html"], made["dcc"]):
        verified = place.certify("verify", file)
        assert (verified["valid"], verified["why"], verified["recorded"]) == (True, "", True)
    page = (place.folder / made["html"]).read_text()
    assert "Robots plc" in page
    for document in (page, (place.folder / made["dcc"]).read_text()):
        assert "5 of 5 held-out loads are checked." in document
        assert "without: drift of the load cell" in document
    assert "<ul>\n<li>Simulated: bench: simulated bench" in page


@pytest.mark.rest
def test_an_overridden_verdict_is_stated_with_who_decided(place):
    with open_store(f"sqlite:///{place.database}") as store:
        run = store.runs.resolve("S-1")
        store.changes.override_verdict(run, Outcome.FAIL, operator="Ada", why="scratched")
        store.changes.override_verdict(run, Outcome.PASS, operator="Bob", why="looked again")
    made = place.certify("S-1", "--to", "out")
    for file in (made["html"], made["dcc"]):
        assert "pass, overridden by Bob: looked again" in (place.folder / file).read_text()


@pytest.mark.rest
def test_what_a_person_overrode_and_what_the_run_warned_of_stand_among_the_remarks(place):
    with open_store(f"sqlite:///{place.database}") as store:
        run = store.runs.resolve("S-1")
        record = store.runs.load(run)
        (stored,) = store.analyses.load(run)
    answers = [
        GateAnswer(GateCheck.DISK, GatePolicy.WARN, GateOutcome.WARNED, "4 GB free"),
        GateAnswer(GateCheck.DISK, GatePolicy.REFUSE, GateOutcome.OVERRIDDEN, "1 GB free", "", "Zoë", "so"),
    ]
    latest = replace(stored, warnings=("3 readings jumped", "common"))
    first = replace(stored, warnings=("common", "the run was paused once"))
    assert list_deviations(replace(record, gate=tuple(answers)), (latest, first)) == (
        "gate, disk: 1 GB free; overridden by Zoë: so",
        "3 readings jumped",
        "common",
        "the run was paused once",
        "gate, disk: 4 GB free",
    )
    with open_store(f"sqlite:///{place.database}") as store:
        made = compose_certificate(store, run, CertificateRequest(place.folder / "out"), datetime.now(UTC))
    assert set(made.certificate.deviations) >= {*stored.warnings, *gate_warnings(record.gate)}


@pytest.mark.rest
def test_a_name_with_xml_in_it_is_text_in_both_documents(place):
    made = place.certify("S-1", "--to", "out", "--customer", HOSTILE)
    assert "<b>Sons" not in (place.folder / made["html"]).read_text()
    assert "<b>Sons" not in (place.folder / made["dcc"]).read_text()
    place.certify("verify", made["dcc"])


@pytest.mark.rest
@pytest.mark.parametrize(
    ("words", "missing"),
    [
        ((), 'the customer is "not stated": give --customer and --customer-address'),
        (("--customer", "Robots plc"), 'the customer is "not stated": give --customer-address'),
        (("--customer", "Robots plc", "--customer-address", "Ring 1"), ""),
    ],
)
def test_a_customer_that_is_not_stated_is_warned_of(place, words, missing, capsys):
    assert run_guarded(["certificate", "S-1", "--to", "out", *words, *place.at]) == 0
    told = capsys.readouterr()
    said = " ".join((told.out + told.err).split())
    assert ("the customer is" in said) is bool(missing)
    assert missing in said


@pytest.mark.rest
def test_the_requirement_of_a_file_is_dropped_by_an_option(place, capsys):
    new_key(place.folder / "a.key")
    words = ["S-1", "--to", "out", "--no-max-error", "--key", "a.key", *place.at]
    assert run_guarded(["certificate", *words]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "No statement of conformity is made: no maximum permissible error was stated." in said
    (signature,) = (place.folder / "out").glob("*.signature.json")
    assert f"signature out/{signature.name}" in said


@pytest.mark.rest
def test_a_batch_is_certified_and_who_got_none_is_named(place, capsys):
    made = place.certify("--batch", "B7", "--to", "out")
    assert [one["number"] for one in made["issued"]] == [path.stem for path in (place.folder / "out").glob("*.html")]
    assert made["refused"] == []
    again = place.certify("--batch", "B7", "--to", "out", code=1)
    assert again["issued"] == []
    assert "stands" in again["refused"][0]["reason"]
    assert run_guarded(["certificate", "--batch", "B7", "--to", "out", *place.at]) == 1
    assert capsys.readouterr().out.startswith("✗ no certificate of batch B7 issued: 1 sensor got none")


def test_months_end_with_the_month():
    assert add_months(date(2027, 1, 31), 1) == date(2027, 2, 28)
    assert add_months(date(2027, 11, 30), 3) == date(2028, 2, 29)
    assert add_months(date(2027, 3, 5), 24) == date(2029, 3, 5)


def test_numbers_of_one_run_differ():
    assert number_certificate("LAB", "r", 0) == "LAB-r"
    assert [number_certificate("LAB", "r", count) for count in (1, 2)] == ["LAB-r-R1", "LAB-r-R2"]


def test_places_are_spread_from_the_centre_on():
    grid = [SimpleNamespace(x_mm=float(x), y_mm=float(y)) for x in range(-30, 31, 10) for y in range(-30, 31, 10)]
    chosen = choose_places(SimpleNamespace(baseline=grid))
    assert len(chosen) == 9
    assert chosen[0] == (0.0, 0.0)
    assert {(x, y) for x in (-30.0, 30.0) for y in (-30.0, 30.0)} <= set(chosen)
    assert choose_places(SimpleNamespace(baseline=grid[:2])) == ((-30.0, -20.0), (-30.0, -30.0))


def test_a_laboratory_may_be_left_out_of_a_station_and_is_checked_in_it(tmp_path):
    write_station(tmp_path / "a.toml")
    assert load_station(str(tmp_path / "a.toml")).value.certificate.prefix == "SSW"
    write_station(tmp_path / "c.toml", laboratory_table(email="office@example.org"))
    assert load_station(str(tmp_path / "c.toml")).value.certificate.email == "office@example.org"
    assert load_certificate_settings(str(tmp_path / "a.toml")).value.max_error_percent == 5.0
    for changes, said in (
        ({"prefix": "ssw"}, "certificate.prefix is 'ssw'; it must be 1 to 24 of A to Z, digits, . and -"),
        ({"prefix": "-SSW"}, "starting with a letter or a digit"),
        (
            {"country": "Germany"},
            "certificate.country is 'Germany'; it must be two letters A to Z, the code of ISO 3166",
        ),
        ({"country": "de"}, "certificate.country"),
        (
            {"email": "office at example.org"},
            "certificate.email is .*; it must be an address of at most 80 characters",
        ),
        ({"signatory": " Ada"}, "certificate.signatory is ' Ada'; it must be one line of 1 to 80 characters"),
        ({"max_error_N": -0.1}, "certificate.max_error_N"),
        ({"max_error_N": 1e-300}, "certificate.max_error_N is 1e-300 N, less than any U .* at least 1e-06 N"),
        ({"max_error_percent": 1e-9}, "certificate.max_error_percent is 1e-09 %, less than any U"),
        ({"decision": "hopeful"}, "certificate.decision"),
        ({"max_error_N": 0.0, "max_error_percent": 0.0}, "are stated together"),
    ):
        write_station(tmp_path / "b.toml", laboratory_table(**changes))
        with pytest.raises(ConfigError, match=said):
            load_station(str(tmp_path / "b.toml"))
