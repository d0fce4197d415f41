"""Certificates of a simulated sensor, from the command line: issued, verified, replaced, revoked, refused."""

import json
import re
import sqlite3
from contextlib import closing
from dataclasses import replace
from datetime import UTC, date, datetime, timedelta
from types import SimpleNamespace

import numpy as np
import pytest
from altered_runs import fill
from certificates import HOSTILE, laboratory_table
from certified_runs import STANDARDS, copy_tested, write_recipe, write_station
from synced import run_of

import cbsr_qa as qa
from cbsr_qa.analysis.run.loads import load_window, mean_force
from cbsr_qa.app.certificate.checked_loads import check_loads
from cbsr_qa.app.certificate.compose import (
    add_months,
    choose_places,
    compose_certificate,
    list_deviations,
    number_certificate,
)
from cbsr_qa.app.certificate.request import CertificateRequest
from cbsr_qa.app.certificate.verify import verify_certificate
from cbsr_qa.app.run.decided_again import judging_recipe
from cbsr_qa.calibration.file.hdf5 import calibration_of
from cbsr_qa.calibration.file.keys import new_key
from cbsr_qa.cli.main import run_guarded
from cbsr_qa.config.loader import load_certificate_settings, load_station
from cbsr_qa.domain.errors import CalibrationError, ConfigError, RefusedError
from cbsr_qa.domain.plan.gate import GateCheck, GatePolicy
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.run.gate import GateAnswer, GateOutcome, gate_warnings
from cbsr_qa.store.opening import open_store

REST = pytest.mark.rest


@pytest.fixture
def place(tmp_path, monkeypatch, capsys):
    """A folder with the database of a sensor that passed; runs commands there, and returns what they print."""
    database = copy_tested(tmp_path, monkeypatch)
    monkeypatch.chdir(tmp_path)

    def certify(*words, code=0):
        arguments = [*map(str, words), "--database", str(database), "--json"]
        assert run_guarded(["certificate", *arguments]) == code, capsys.readouterr().err
        return json.loads(capsys.readouterr().out)

    at = ["--database", str(database)]
    return SimpleNamespace(folder=tmp_path, database=database, at=at, certify=certify)


def change(database, statement):
    with closing(sqlite3.connect(database)) as opened, opened:
        assert opened.execute(statement).rowcount >= 1


def issued_nothing(place):
    with open_store(f"sqlite:///{place.database}") as store:
        assert store.certificates.list_all() == ()
    assert not (place.folder / "out").exists()


@REST
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


@REST
@pytest.mark.parametrize("letter", ["\\u0007", "\\u202E", "\\u200B"])
def test_texts_that_cannot_be_printed_are_named(place, letter, capsys):
    """XML has no control characters, and others turn or hide what is signed."""
    file = place.folder / "laboratory.toml"
    file.write_text(laboratory_table().replace("Soft Sensor Works", f"Soft{letter}Sensor"))
    assert run_guarded(["certificate", "S-1", "--to", "out", "--laboratory", str(file), *place.at]) == 2
    assert "certificate.laboratory" in (said := capsys.readouterr().err)
    assert "printed, in one line" in " ".join(said.split())
    issued_nothing(place)


@REST
def test_a_folder_below_a_file_is_named(place, capsys):
    (place.folder / "file").write_text("")
    assert run_guarded(["certificate", "S-1", "--to", "file/out", *place.at]) == 2
    assert "file/out" in capsys.readouterr().err
    with open_store(f"sqlite:///{place.database}") as store:
        assert store.certificates.list_all() == ()


@REST
def test_an_overridden_verdict_is_stated_with_who_decided(place):
    with open_store(f"sqlite:///{place.database}") as store:
        run = store.runs.resolve("S-1")
        store.changes.override_verdict(run, Outcome.FAIL, operator="Ada", why="scratched")
        store.changes.override_verdict(run, Outcome.PASS, operator="Bob", why="looked again")
    made = place.certify("S-1", "--to", "out")
    for file in (made["html"], made["dcc"]):
        assert "pass, overridden by Bob: looked again" in (place.folder / file).read_text()


@REST
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


@REST
def test_a_validity_beyond_the_time_that_u_is_stated_for_is_refused(place):
    """Also where no drift of gains is stated, as here: less data must not allow a stronger claim."""
    refused = place.certify("S-1", "--to", "out", "--validity-months", "13", code=2)["refused"]
    assert "U in use is stated for 12 months at most, and the validity is 13" in refused["reason"]
    issued_nothing(place)


@REST
def test_a_certificate_is_not_issued_before_its_calibration(place):
    with open_store(f"sqlite:///{place.database}") as store:
        run = store.runs.resolve("S-1")
        (analysis,) = store.analyses.load(run)
        early = analysis.analysed_at - timedelta(days=30)
        said = f"it is {early.date()}, and the calibration was made on {analysis.analysed_at.date()}"
        with pytest.raises(RefusedError, match=f"by the clock of this computer {said}"):
            compose_certificate(store, run, CertificateRequest(place.folder / "out"), early)


@REST
def test_one_changed_byte_is_named_in_page_and_xml(place):
    made = place.certify("S-1", "--to", "out")
    for file in (made["html"], made["dcc"]):
        path = place.folder / file
        whole = path.read_bytes()
        for at in (0, len(whole) // 2, len(whole) - 1):
            path.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
            assert "changed since it was issued" in place.certify("verify", file, code=1)["why"]
        path.write_bytes(whole)
        place.certify("verify", file)


@REST
def test_a_signed_certificate_is_verified_without_the_database(place, monkeypatch):
    new_key(place.folder / "a.key")
    new_key(place.folder / "b.key")
    made = place.certify("S-1", "--to", "out", "--key", "a.key")
    monkeypatch.setenv("CBSR_QA_VAR", str(place.folder / "elsewhere"))
    path = place.folder / made["dcc"]
    good = verify_certificate(path, public_key=place.folder / "a.key.pub").result
    assert (good.valid, good.pinned, good.recorded) == (True, True, False)
    other = verify_certificate(path, public_key=place.folder / "b.key.pub").result
    assert "not by the pinned key" in other.why
    path.write_bytes(path.read_bytes().replace(b"S-1", b"S-2"))
    assert "changed since it was issued" in verify_certificate(path).result.why
    path.with_name(f"{made['number']}.signature.json").unlink()
    assert "it is unknown who issued it" in verify_certificate(path).result.why
    assert "a signature is required" in verify_certificate(path, public_key=place.folder / "a.key.pub").result.why


@REST
def test_a_certificate_lapses(place):
    made = place.certify("S-1", "--to", "out", "--validity-months", "1")
    path = place.folder / made["html"]
    database = str(place.database)
    until = date.fromisoformat(place.certify("verify", path)["valid_until"])
    assert verify_certificate(path, database=database, today=until).result.valid
    lapsed = verify_certificate(path, database=database, today=add_months(until, 1)).result
    assert lapsed.why == f"it lapsed: it was valid until {until}"


@REST
@pytest.mark.parametrize(
    ("statement", "said"),
    [
        ("update frame_blocks set voltages = cast(x'01' || substr(voltages, 2) as blob)", "frame"),
        ("update sample_blocks set sample_values = cast(x'01' || substr(sample_values, 2) as blob)", "sample"),
        ("update loads set x_mm = x_mm + 1", "loads .* was changed"),
        ("update calibrations set file = zeroblob(length(file))", "calibration"),
        ("update runs set chain = null", "states no chain"),
    ],
)
def test_a_certificate_does_not_hold_if_its_run_was_altered(place, statement, said):
    made = place.certify("S-1", "--to", "out")
    change(place.database, statement)
    verified = place.certify("verify", made["html"], code=1)
    assert re.search(said, verified["why"]), verified["why"]
    assert not verified["recorded"]


@REST
def test_a_clock_before_the_day_of_issue_is_named(place):
    new_key(place.folder / "a.key")
    made = place.certify("S-1", "--to", "out", "--key", "a.key")
    path, early = place.folder / made["html"], date(1970, 1, 1)
    for database in (str(place.database), None):
        why = verify_certificate(path, database=database, today=early).result.why
        assert re.fullmatch("it was signed on .*, and by the clock of this computer it is 1970-01-01: .*", why)


@REST
def test_a_replacement_names_the_old_one_which_no_longer_holds(place):
    old = place.certify("S-1", "--to", "out", "--customer", "Robots")
    stands = place.certify("S-1", "--to", "out", code=2)["refused"]
    assert stands["reason"] == f"certificate {old['number']} of this run stands"
    new = place.certify("S-1", "--to", "out", "--replaces", old["number"], "--reason", "customer <renamed>")
    assert new["number"] == f"{old['number']}-R1"
    assert "customer &lt;renamed&gt;" in (place.folder / new["html"]).read_text()
    why = place.certify("verify", old["html"], code=1)["why"]
    assert f"certificate {old['number']} was replaced by certificate {new['number']}" in why
    assert why.endswith("by Ada Otani: customer <renamed>")
    place.certify("verify", new["html"])
    again = place.certify("S-1", "--to", "out", "--replaces", old["number"], "--reason", "x", code=2)["refused"]
    assert "does not stand" in again["reason"]


@REST
def test_a_revoked_certificate_is_named_by_database_list_and_runtime(place, capsys):
    new_key(place.folder / "a.key")
    made = place.certify("S-1", "--to", "out", "--key", "a.key")
    place.certify("revoke", made["number"], "--reason", "wrong head", "--by", "Zoë")
    assert "was revoked on" in place.certify("verify", made["dcc"], code=1)["why"]
    (listed,) = place.certify("list", "S-1")["certificates"]
    assert listed["withdrawn"].endswith("by Zoë: wrong head")
    place.certify("withdrawn", "--to", "withdrawn.json", "--key", "a.key")
    path = place.folder / made["html"]
    empty = place.folder / "elsewhere.db"
    with open_store(f"sqlite:///{empty}"):
        pass
    assert "no certificate" in verify_certificate(path, database=str(empty)).result.why
    found = verify_certificate(path, withdrawn=place.folder / "withdrawn.json", database=str(place.database)).result
    assert "was revoked on" in found.why
    assert run_guarded(["report", "S-1", "--database", str(place.database)]) == 0
    capsys.readouterr()
    (calibration,) = (place.folder / "var" / "calibrations").glob("*.h5")
    seal = place.folder / "out" / f"{made['number']}.signature.json"
    options = {"public_key": place.folder / "a.key.pub", "certificate": seal}
    assert qa.load_calibration(calibration, **options).issued.force is not None
    with pytest.raises(CalibrationError, match="was revoked on"):
        qa.load_calibration(calibration, **options, withdrawn=place.folder / "withdrawn.json")
    with pytest.raises(CalibrationError, match="lapsed"):
        qa.Calibration.load(calibration, **options, today=date(2999, 1, 1))
    press = str(place.folder / "press.h5")
    assert run_guarded(["export", "S-1", "--to", press, "--database", str(place.database)]) == 0
    apply = ("calibration", "apply", str(calibration), press, "--certificate", str(seal))
    assert run_guarded([*apply]) == 0
    capsys.readouterr()
    assert run_guarded([*apply, "--withdrawn", "withdrawn.json"]) == 2
    assert "was revoked on" in capsys.readouterr().err


@REST
def test_a_verdict_that_is_overridden_later_is_named(place, capsys):
    made = place.certify("S-1", "--to", "out")
    with open_store(f"sqlite:///{place.database}") as store:
        run = store.runs.resolve("S-1")
    words = ["verdict", "override", run, "--by", "Bob", "--why", "scratched", "--json", *place.at]
    assert run_guarded([*words, "--outcome", "fail"]) == 0
    assert json.loads(capsys.readouterr().out)["standing_certificates"] == [made["number"]]
    why = place.certify("verify", made["dcc"], code=1)["why"]
    assert why == "the verdict of its run is fail now: overridden by Bob: scratched"
    assert run_guarded([*words, "--outcome", "pass"]) == 0
    capsys.readouterr()
    place.certify("verify", made["dcc"])


@REST
def test_a_list_speaks_of_certificates_of_its_own_key_until_its_day(place, monkeypatch, capsys):
    assert run_guarded(["report", "S-1", *place.at]) == 0
    capsys.readouterr()
    for name in ("a.key", "b.key"):
        new_key(place.folder / name)
    made = place.certify("S-1", "--to", "out", "--key", "a.key")
    for name in ("a", "b"):
        place.certify("withdrawn", "--to", f"{name}.json", "--key", f"{name}.key")
    monkeypatch.setenv("CBSR_QA_VAR", str(place.folder / "elsewhere"))
    path, seal = place.folder / made["dcc"], place.folder / "out" / f"{made['number']}.signature.json"
    listed = verify_certificate(path, withdrawn=place.folder / "a.json")
    assert (listed.result.valid, listed.result.list_of) == (True, f"{datetime.now(UTC):%Y-%m-%d}")
    assert any("after the list was signed" in warning for warning in listed.page.warnings)
    assert verify_certificate(path).result.list_of is None
    other = verify_certificate(path, withdrawn=place.folder / "b.json").result
    assert "the certificate by key" in other.why
    (calibration,) = (place.folder / "var" / "calibrations").glob("*.h5")
    with pytest.raises(CalibrationError, match="the certificate by key"):
        qa.load_calibration(calibration, certificate=seal, withdrawn=place.folder / "b.json")


@REST
def test_a_revoked_certificate_is_followed_by_one_that_names_it_with_both_facts(place):
    first = place.certify("S-1", "--to", "out")
    place.certify("revoke", first["number"], "--reason", "wrong customer", "--by", "Zoë")
    fresh = place.certify("S-1", "--to", "out", code=2)["refused"]
    assert f"certificate {first['number']} of this run was revoked on" in fresh["reason"]
    assert "--replaces" in fresh["remedy"]
    second = place.certify("S-1", "--to", "out", "--replaces", first["number"], "--reason", "right customer")
    assert second["number"] == f"{first['number']}-R1"
    for file in (second["html"], second["dcc"]):
        text = (place.folder / file).read_text()
        assert re.search(
            f"replaces certificate {first['number']}, which was revoked on .* by Zoë: wrong customer", text
        )
        assert "Reason of the replacement: right customer" in text
    why = place.certify("verify", first["html"], code=1)["why"]
    assert re.search("was revoked on .*wrong customer; replaced by certificate .*-R1 on .*right customer", why)
    assert place.certify("revoke", first["number"], "--reason", "again", code=2)["refused"]["reason"].startswith(
        f"certificate {first['number']} does not stand"
    )


@REST
def test_files_are_written_again_byte_for_byte(place):
    new_key(place.folder / "a.key")
    made = place.certify("S-1", "--to", "out", "--key", "a.key")
    place.certify("copy", made["number"], "--to", "again")
    names = sorted(path.name for path in (place.folder / "out").iterdir())
    assert [name.removeprefix(made["number"]) for name in names] == [".html", ".signature.json", ".xml"]
    for name in names:
        assert (place.folder / "again" / name).read_bytes() == (place.folder / "out" / name).read_bytes()
    assert "exists already" in place.certify("copy", made["number"], "--to", "again", code=2)["refused"]["reason"]


@REST
def test_a_name_with_xml_in_it_is_text_in_both_documents(place):
    made = place.certify("S-1", "--to", "out", "--customer", HOSTILE)
    assert "<b>Sons" not in (place.folder / made["html"]).read_text()
    assert "<b>Sons" not in (place.folder / made["dcc"]).read_text()
    place.certify("verify", made["dcc"])


REFUSED = {
    "no run": (None, ("S-9", "--to", "out"), "there is no run and no sensor 'S-9'"),
    "a broken chain": ("update loads set x_mm = x_mm + 1", ("S-1", "--to", "out"), "loads .* was changed"),
    "a changed frame": ("update frame_blocks set voltages = zeroblob(9)", ("S-1", "--to", "out"), "frame"),
    "no chain": ("update runs set chain = null", ("S-1", "--to", "out"), "states no chain"),
    "no customer's name": (None, ("S-1", "--to", "out", "--customer", "a\nb"), "n' cannot be printed"),
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
        "^--validity-months has 1 problem.*certificate.validity_months is 0; it must be a whole number from 1 to 120",
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


@REST
@pytest.mark.parametrize(("statement", "words", "said"), REFUSED.values(), ids=REFUSED)
def test_what_cannot_be_certified_is_named_and_nothing_is_issued(place, statement, words, said):
    if statement is not None:
        change(place.database, statement)
    refused = place.certify(*words, code=2)["refused"]
    assert re.search(said, " ".join(refused["reason"].split())), refused
    if statement is None:
        issued_nothing(place)
    assert not (place.folder / "out").exists()


@REST
def test_a_destination_that_exists_is_refused(place):
    with open_store(f"sqlite:///{place.database}") as store:
        run = store.runs.resolve("S-1")
    (place.folder / "out").mkdir()
    (place.folder / "out" / f"SSW-{run}.xml").write_text("mine")
    assert "exists already" in place.certify("S-1", "--to", "out", code=2)["refused"]["reason"]
    assert [path.name for path in (place.folder / "out").iterdir()] == [f"SSW-{run}.xml"]


@REST
def test_a_sensor_that_failed_is_refused_also_by_a_person(place, capsys):
    with open_store(f"sqlite:///{place.database}") as store:
        run = store.runs.resolve("S-1")
    words = ("verdict", "override", run, "--outcome", "fail", "--by", "Ada", "--why", "scratched")
    assert run_guarded([*words, "--database", str(place.database)]) == 0
    capsys.readouterr()
    refused = place.certify("S-1", "--to", "out", code=2)["refused"]["reason"]
    assert refused == f"sensor S-1 is not certified: the verdict of run {run} is fail: overridden by Ada: scratched"
    issued_nothing(place)


@REST
def test_the_requirement_of_a_file_is_dropped_by_an_option(place, capsys):
    new_key(place.folder / "a.key")
    words = ["S-1", "--to", "out", "--no-max-error", "--key", "a.key", *place.at]
    assert run_guarded(["certificate", *words]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "No statement of conformity is made: no maximum permissible error was stated." in said
    (signature,) = (place.folder / "out").glob("*.signature.json")
    assert f"signature out/{signature.name}" in said


@REST
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


@REST
def test_a_list_is_not_written_over_another_file(place):
    new_key(place.folder / "a.key")
    before = (place.folder / "station.toml").read_text()
    refused = place.certify("withdrawn", "--to", "station.toml", "--key", "a.key", code=2)["refused"]
    assert refused["reason"] == "station.toml exists, and is not a list of withdrawn certificates"
    assert (place.folder / "station.toml").read_text() == before


@REST
def test_a_batch_is_certified_and_who_got_none_is_named(place, capsys):
    made = place.certify("--batch", "B7", "--to", "out")
    assert [one["number"] for one in made["issued"]] == [path.stem for path in (place.folder / "out").glob("*.html")]
    assert made["refused"] == []
    again = place.certify("--batch", "B7", "--to", "out", code=1)
    assert again["issued"] == []
    assert "stands" in again["refused"][0]["reason"]
    assert run_guarded(["certificate", "--batch", "B7", "--to", "out", *place.at]) == 1
    assert capsys.readouterr().out.startswith("✗ no certificate of batch B7 issued: 1 sensor got none")


@REST
def test_a_forged_certificate_is_refused_where_the_database_has_none_of_it(place):
    """Somebody makes a key, a number and a page, and signs them."""
    new_key(place.folder / "a.key")
    made = place.certify("S-1", "--to", "out", "--key", "a.key")
    with open_store(f"sqlite:///{place.folder / 'var' / 'cbsr-qa.db'}"):
        pass  # of another laboratory
    path = place.folder / made["html"]
    assert f"has no certificate {made['number']}" in verify_certificate(path).result.why
    assert verify_certificate(path, public_key=place.folder / "a.key.pub").result.valid


def _run_and_refuse(folder, serial, monkeypatch, capsys):
    """Test a sensor with the files of a folder, and ask for its certificate; return why there is none."""
    monkeypatch.setenv("CBSR_QA_VAR", str(folder / "var"))
    monkeypatch.chdir(folder)
    run = ("run", "--station", "station.toml", "--recipe", "recipe.toml", "--serial", serial, "--operator", "Ada")
    run_guarded([*run, "--json"])
    capsys.readouterr()
    assert run_guarded(["certificate", serial, "--to", "out", "--json"]) == 2
    assert not (folder / "out").exists()
    return json.loads(capsys.readouterr().out)["refused"]["reason"]


@REST
def test_a_standard_that_was_overdue_is_named(tmp_path, monkeypatch, capsys):
    write_recipe(tmp_path / "recipe.toml")
    overdue = STANDARDS.replace("2099-03-31", "2026-02-28")
    write_station(tmp_path / "station.toml", standards=overdue)
    said = _run_and_refuse(tmp_path, "S-1", monkeypatch, capsys)
    assert "the calibration of the load cell (certificate K-7) was due on 2026-02-28" in said


@REST
def test_an_instrument_that_was_overdue_is_named(tmp_path, monkeypatch, capsys):
    """The gate of the shipped station only warns of it."""
    write_recipe(tmp_path / "recipe.toml")
    write_station(tmp_path / "station.toml")
    station = (tmp_path / "station.toml").read_text()
    due = '[instruments.bench]\ncalibration_due = "2026-02-28"\n'
    (tmp_path / "station.toml").write_text(station.replace("[instruments.bench]\n", due))
    said = _run_and_refuse(tmp_path, "S-1", monkeypatch, capsys)
    assert "the calibration of bench (simulated-bench) was due on 2026-02-28" in said


@REST
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


@REST
def test_held_out_loads_are_checked_or_named_whatever_the_range(place):
    """A range that fewer loads agree with moves loads from one list to the other, with the same errors."""
    with open_store(f"sqlite:///{place.database}") as store:
        run = store.runs.resolve("S-1")
        record, stored = store.runs.load(run), store.analyses.load(run)[0]
        file, digest = store.calibrations.load_file(stored.calibration)
        recipe = judging_recipe(store, run, stored)
    issued = calibration_of(file, issued=digest)
    wide, narrow = (
        replace(issued, validity=replace(issued.validity, force_N=(0.0, high_N))) for high_N in (100.0, 2.0)
    )
    everything, nothing = check_loads(record, recipe, qa.Calibration(wide), None)
    some, others = check_loads(record, recipe, qa.Calibration(narrow), None)
    assert (len(everything), nothing) == (5, ())
    assert 0 < len(others) < 5
    errors_N = {load.reference_N: load.error_N for load in (*some, *others)}
    assert errors_N == {load.reference_N: load.error_N for load in everything}
    assert all(not load.why and load.reference_N > 2.0 for load in others)


@REST
def test_a_load_that_ends_the_range_is_checked(place):
    """The range ends at means over the steady frames; the last of them, whose error is stated, has another force."""
    with open_store(f"sqlite:///{place.database}") as store:
        run = store.runs.resolve("S-1")
        record, stored = store.runs.load(run), store.analyses.load(run)[0]
        file, digest = store.calibrations.load_file(stored.calibration)
        recipe = judging_recipe(store, run, stored)
    issued = calibration_of(file, issued=digest)
    (phase,) = [phase for phase in record.phases if phase.name == "random loads"]
    for load in phase.loads:
        steady_N, _ = mean_force(phase.channel("force"), load_window(phase, load, recipe.analysis).steady, load)
        radius_mm = float(np.hypot(load.load.x_mm, load.load.y_mm))
        for range_N in ((0.0, steady_N), (steady_N, 100.0)):
            ends_here = replace(issued.validity, force_N=range_N, radius_mm=radius_mm)
            checked, _ = check_loads(record, recipe, qa.Calibration(replace(issued, validity=ends_here)), None)
            assert (load.load.x_mm, load.load.y_mm) in [one.expanded.place_mm for one in checked]


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
