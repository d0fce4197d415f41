"""A station that signs its calibrations: the page as printed, the bytes in the database, a key that is gone."""

import json
import sqlite3
from contextlib import closing

import killing
import pytest
from command import cbsr_qa, refused
from pages import HOW_TO, blocks, commands, typed
from streamed import write_sensor

import cbsr_qa as qa
from cbsr_qa.app.run.console import Unattended
from cbsr_qa.app.run.request import RunRequest
from cbsr_qa.app.run.resume import resume_run
from cbsr_qa.app.run.run import run_sensor
from cbsr_qa.calibration.file.keys import new_key
from cbsr_qa.domain.errors import BrokenRunError

pytestmark = pytest.mark.rest

_PAGE = HOW_TO / "sign-calibrations.md"
_RUN = ("run", "--station", "bench.toml", "--recipe", "nine-locations", "--serial", "S-1", "--operator", "Z")


def _signing(folder):
    """The table of the page, with keys in a folder."""
    (table,) = blocks(_PAGE, "toml")
    return table.replace("/etc/cbsr-qa", str(folder))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A bench whose station file has the table of the page, and what a robot has."""
    monkeypatch.chdir(tmp_path)
    write_sensor(tmp_path, 8)
    killing.write_files(tmp_path)
    (tmp_path / "bench.toml").write_text(f"{(tmp_path / 'station.toml').read_text()}\n{_signing(tmp_path)}")
    return tmp_path


def test_the_page_runs_with_a_short_recipe_and_the_database_holds_the_signed_bytes(folder):
    for line in commands(_PAGE):
        typed(folder, line.replace("--recipe nine-locations", "--recipe recipe.toml"))
    (snippet,) = blocks(_PAGE, "python")
    exec(snippet, {})
    (issued,) = (folder / "var" / "calibrations").iterdir()
    done = cbsr_qa(folder, "calibration", "verify", issued, "--public-key", "station.key.pub", "--json")
    assert json.loads(done.stdout)["signature"]["pinned"] is True
    database = folder / "var" / "cbsr-qa.db"
    with closing(sqlite3.connect(database)) as held:
        assert held.execute("SELECT file FROM calibrations").fetchall() == [(issued.read_bytes(),)]
    assert qa.open_database(str(database)).run("S-1").calibration().issued.signature is not None
    before = issued.read_bytes()
    issued.unlink()
    cbsr_qa(folder, "report", "S-1")
    assert issued.read_bytes() == before
    page = next((folder / "var" / "reports").glob("*.html")).read_text()
    assert "issued, signed by key" in page


def test_a_key_that_cannot_be_used_refuses_before_anything_moves(folder):
    for extra in ((), ("--dry-run",)):
        said = refused(folder, *_RUN, *extra)
        assert "calibrations.signing_key: key" in said
        assert "station.key cannot be read" in said
    assert not (folder / "var" / "cbsr-qa.db").exists()
    text = (folder / "bench.toml").read_text()
    (folder / "bench.toml").write_text(text.replace(f'"{folder}/station.key"', '"station.key"'))
    line = 1 + next(n for n, row in enumerate(text.splitlines()) if "signing_key" in row)
    assert f"bench.toml line {line}: calibrations.signing_key is not a full path" in refused(folder, *_RUN)


def test_a_key_that_is_gone_when_the_run_ends_issues_nothing_until_it_is_back(folder, monkeypatch):
    """What is measured is kept, and the named command computes the result, without moving anything."""
    monkeypatch.setenv("CBSR_QA_VAR", str(folder / "var"))
    key, away = folder / "station.key", folder / "away.key"
    new_key(key)

    class Removing(Unattended):
        def begin(self, run):
            key.rename(away)

    request = RunRequest("bench.toml", "recipe.toml", "S-1", seed=5, operator="Z")
    with pytest.raises(BrokenRunError, match="its calibration cannot be signed, and is not issued") as error:
        run_sensor(request, Removing())
    assert "then this computes the result: cbsr-qa" in error.value.remedy
    assert not list((folder / "var" / "calibrations").glob("*.h5"))
    away.rename(key)
    outcome = resume_run(error.value.run)
    assert qa.load_calibration(outcome.calibration, public_key=f"{key}.pub").issued.signature is not None
