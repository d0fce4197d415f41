"""A folder with the database of a sensor that passed, for tests of its certificates."""

import json
import sqlite3
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import pytest
from certified_runs import copy_tested

from cbsr_qa.cli.main import run_guarded
from cbsr_qa.store.opening import open_store


@dataclass(frozen=True)
class Place:
    """A folder, and the database in it; runs commands there, and returns what they print."""

    folder: Path
    database: Path
    capsys: pytest.CaptureFixture[str]

    @property
    def at(self):
        return ["--database", str(self.database)]

    def certify(self, *words, code=0):
        arguments = ["certificate", *map(str, words), *self.at, "--json"]
        assert run_guarded(arguments) == code, self.capsys.readouterr().err
        return json.loads(self.capsys.readouterr().out)

    def change(self, statement):
        with closing(sqlite3.connect(self.database)) as opened, opened:
            assert opened.execute(statement).rowcount >= 1

    def check_nothing_issued(self):
        with open_store(f"sqlite:///{self.database}") as store:
            assert store.certificates.list_all() == ()
        assert not (self.folder / "out").exists()


@pytest.fixture
def place(tmp_path, monkeypatch, capsys):
    database = copy_tested(tmp_path, monkeypatch)
    monkeypatch.chdir(tmp_path)
    return Place(tmp_path, database, capsys)
