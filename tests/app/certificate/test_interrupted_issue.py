"""A certificate is recorded before its files have their names: a command that is killed gives no number twice."""

import pytest

from cbsr_qa.calibration.file.keys import new_key
from cbsr_qa.cli.main import run_guarded
from cbsr_qa.store.results.certificates import Certificates


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
