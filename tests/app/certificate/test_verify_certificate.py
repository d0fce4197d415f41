"""Whether a certificate holds, by its files, its signature, its database and a list."""

import json
import re
from datetime import UTC, date, datetime

import pytest

import cbsr_qa as qa
from cbsr_qa.app.certificate.compose import (
    add_months,
)
from cbsr_qa.app.certificate.verify import verify_certificate
from cbsr_qa.app.certificate.withdraw import write_withdrawn
from cbsr_qa.calibration.file.keys import new_key
from cbsr_qa.cli.main import run_guarded
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.results.analyses import Analyses


@pytest.mark.rest
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


@pytest.mark.rest
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


@pytest.mark.rest
def test_a_certificate_lapses(place):
    made = place.certify("S-1", "--to", "out", "--validity-months", "1")
    path = place.folder / made["html"]
    database = str(place.database)
    until = date.fromisoformat(place.certify("verify", path)["valid_until"])
    assert verify_certificate(path, database=database, today=until).result.valid
    lapsed = verify_certificate(path, database=database, today=add_months(until, 1)).result
    assert lapsed.why == f"it lapsed: it was valid until {until}"


@pytest.mark.rest
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
    place.change(statement)
    verified = place.certify("verify", made["html"], code=1)
    assert re.search(said, verified["why"]), verified["why"]
    assert not verified["recorded"]


@pytest.mark.rest
def test_a_clock_before_the_day_of_issue_is_named(place):
    new_key(place.folder / "a.key")
    made = place.certify("S-1", "--to", "out", "--key", "a.key")
    path, early = place.folder / made["html"], date(1970, 1, 1)
    for database in (str(place.database), None):
        why = verify_certificate(path, database=database, today=early).result.why
        assert re.fullmatch("it was signed on .*, and by the clock of this computer it is 1970-01-01: .*", why)


@pytest.mark.rest
def test_a_verdict_that_is_overridden_later_is_named(place, capsys):
    new_key(place.folder / "a.key")
    made = place.certify("S-1", "--to", "out")
    with open_store(f"sqlite:///{place.database}") as store:
        run = store.runs.resolve("S-1")
    words = ["verdict", "override", run, "--by", "Bob", "--why", "scratched", "--json", *place.at]
    assert run_guarded([*words, "--outcome", "fail"]) == 0
    assert json.loads(capsys.readouterr().out)["standing_certificates"] == [made["number"]]
    why = place.certify("verify", made["dcc"], code=1)["why"]
    assert why == "the verdict of its run is fail now: overridden by Bob: scratched"
    (listed,) = place.certify("list")["certificates"]
    assert (listed["withdrawn"], listed["run_problem"]) == (None, why)
    (warning,) = write_withdrawn(
        place.folder / "w.json", place.folder / "a.key", database=str(place.database)
    ).page.warnings
    assert f"certificate {made['number']} stands, and is not listed: {why}" in warning
    assert run_guarded([*words, "--outcome", "pass"]) == 0
    capsys.readouterr()
    place.certify("verify", made["dcc"])
    assert place.certify("list")["certificates"][0]["run_problem"] is None


@pytest.mark.rest
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
    listed = verify_certificate(path, withdrawn=place.folder / "a.json", public_key=place.folder / "a.key.pub")
    assert (listed.result.valid, listed.result.list_of) == (True, f"{datetime.now(UTC):%Y-%m-%d}")
    assert any("after the list was signed" in warning for warning in listed.page.warnings)
    unknown = verify_certificate(path)
    assert (unknown.result.valid, unknown.result.list_of, unknown.exit_code) == (False, None, 1)
    assert "no key was pinned, so anybody may have made it" in unknown.result.why
    assert unknown.page.banner.headline.endswith("is unchanged; who signed it is not known")
    other = verify_certificate(path, withdrawn=place.folder / "b.json").result
    assert "the certificate by key" in other.why
    (calibration,) = (place.folder / "var" / "calibrations").glob("*.h5")
    with pytest.raises(CalibrationError, match="the certificate by key"):
        qa.load_calibration(calibration, certificate=seal, withdrawn=place.folder / "b.json")


@pytest.mark.rest
def test_a_forged_certificate_is_refused_where_the_database_has_none_of_it(place):
    """Somebody makes a key, a number and a page, and signs them."""
    new_key(place.folder / "a.key")
    made = place.certify("S-1", "--to", "out", "--key", "a.key")
    with open_store(f"sqlite:///{place.folder / 'var' / 'cbsr-qa.db'}"):
        pass  # of another laboratory
    path = place.folder / made["html"]
    assert f"has no certificate {made['number']}" in verify_certificate(path).result.why
    assert verify_certificate(path, public_key=place.folder / "a.key.pub").result.valid


@pytest.mark.rest
def test_a_run_without_a_result_is_named(place, monkeypatch):
    made = place.certify("S-1", "--to", "out")
    monkeypatch.setattr(Analyses, "load", lambda *_: ())  # as after a session that began since
    assert "has no result now" in place.certify("verify", made["dcc"], code=1)["why"]


@pytest.mark.rest
def test_a_certificate_that_the_database_lost_is_named_although_its_key_is_pinned(place, monkeypatch):
    new_key(place.folder / "a.key")
    made = place.certify("S-1", "--to", "out", "--key", "a.key")
    monkeypatch.setenv("CBSR_QA_DATABASE", str(place.database))
    path, key = place.folder / made["dcc"], place.folder / "a.key.pub"
    place.change("delete from certificates")
    found = verify_certificate(path, public_key=key)
    assert re.search("certificates .* was removed", found.result.why)
    place.change("delete from run_links where kind = 'certificates'")  # the last link of the run
    found = verify_certificate(path, public_key=key)
    assert found.result.why.endswith(f"has no certificate {made['number']}, though its run was begun there")
    assert not any("not looked up" in warning for warning in found.page.warnings)
