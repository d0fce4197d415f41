"""Certificates are replaced, revoked, listed and written again, also after an interruption."""

import re
from datetime import date

import pytest

import cbsr_qa as qa
from cbsr_qa.app.certificate.verify import verify_certificate
from cbsr_qa.calibration.file.keys import new_key
from cbsr_qa.cli.main import run_guarded
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.results.certificates import Certificates


@pytest.mark.rest
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


@pytest.mark.rest
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


@pytest.mark.rest
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


@pytest.mark.rest
def test_files_are_written_again_byte_for_byte(place):
    new_key(place.folder / "a.key")
    made = place.certify("S-1", "--to", "out", "--key", "a.key")
    place.certify("copy", made["number"], "--to", "again")
    names = sorted(path.name for path in (place.folder / "out").iterdir())
    assert [name.removeprefix(made["number"]) for name in names] == [".html", ".signature.json", ".xml"]
    for name in names:
        assert (place.folder / "again" / name).read_bytes() == (place.folder / "out" / name).read_bytes()
    (place.folder / "again" / names[0]).unlink()
    assert [path.name for path in (place.folder / "again").iterdir() if path.suffix == ".html"] == []
    place.certify("copy", made["number"], "--to", "again")
    assert (place.folder / "again" / names[0]).read_bytes() == (place.folder / "out" / names[0]).read_bytes()
    (place.folder / "again" / names[0]).write_text("mine")
    assert "exists already" in place.certify("copy", made["number"], "--to", "again", code=2)["refused"]["reason"]
    assert (place.folder / "again" / names[0]).read_text() == "mine"


@pytest.mark.rest
def test_a_list_is_not_written_over_another_file(place):
    new_key(place.folder / "a.key")
    before = (place.folder / "station.toml").read_text()
    refused = place.certify("withdrawn", "--to", "station.toml", "--key", "a.key", code=2)["refused"]
    assert refused["reason"] == "station.toml exists, and is not a list of withdrawn certificates"
    assert (place.folder / "station.toml").read_text() == before


@pytest.mark.rest
def test_a_list_is_not_replaced_by_one_that_lost_a_revocation(place):
    new_key(place.folder / "a.key")
    made = place.certify("S-1", "--to", "out", "--key", "a.key")
    place.certify("revoke", made["number"], "--reason", "wrong head", "--by", "Zoë")
    words = ("withdrawn", "--to", "withdrawn.json", "--key", "a.key")
    for _ in range(2):
        place.certify(*words)
    before = (place.folder / "withdrawn.json").read_bytes()
    for table in ("certificate_withdrawals", "run_links where kind = 'certificate_withdrawals'"):  # the last link
        place.change(f"delete from {table}")
    refused = place.certify(*words, code=2)["refused"]
    assert refused["reason"] == (
        f"withdrawn.json names certificate {made['number']}, which is not withdrawn in this database"
    )
    assert "name another file" in refused["remedy"]
    assert (place.folder / "withdrawn.json").read_bytes() == before


def names_in(folder):
    """Return the names of files of certificates: hidden ones are parts of files."""
    return [path.name for path in folder.iterdir() if not path.name.startswith(".")]


@pytest.mark.rest
def test_no_file_has_the_name_of_a_certificate_before_it_is_recorded(place, monkeypatch):
    save, seen = Certificates.save, []

    def save_and_look(self, *arguments, **options):
        seen.append(names_in(place.folder / "out"))  # what a command leaves that is killed here
        save(self, *arguments, **options)
        seen.append(names_in(place.folder / "out"))

    monkeypatch.setattr(Certificates, "save", save_and_look)
    made = place.certify("S-1", "--to", "out")
    assert seen == [[], []]
    assert sorted(names_in(place.folder / "out")) == [f"{made['number']}.html", f"{made['number']}.xml"]


@pytest.mark.rest
def test_a_certificate_that_was_recorded_and_not_named_is_written_again(place, monkeypatch, capsys):
    new_key(place.folder / "a.key")
    save = Certificates.save

    def save_and_stop(self, *arguments, **options):
        save(self, *arguments, **options)
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(Certificates, "save", save_and_stop)
        assert run_guarded(["certificate", "S-1", "--to", "out", "--key", "a.key", *place.at]) == 3
    capsys.readouterr()
    assert not (place.folder / "out").exists()
    refused = place.certify("S-1", "--to", "out", "--key", "a.key", code=2)["refused"]
    (listed,) = place.certify("list")["certificates"]
    again = f"`cbsr-qa certificate copy {listed['number']} --to FOLDER` writes its files again"
    assert again in refused["remedy"]
    (page, *_) = place.certify("copy", listed["number"], "--to", "out")["files"]
    place.certify("verify", page, "--public-key", "a.key.pub")
