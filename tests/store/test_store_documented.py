"""The database reference names every table with every column, and its questions can be asked."""

import re
import sqlite3
from pathlib import Path

import pytest
from stored_runs import calibration, journalled, short_run

from cbsr_qa.domain.results import Outcome, RunResult, Verdict
from cbsr_qa.store import open_store
from cbsr_qa.store.tables import AnalysisRow

PAGE = (Path(__file__).parents[2] / "docs" / "reference" / "database.md").read_text()
ROWS = dict(re.findall(r"^\| `(\w+)` \| [^|]+ \| (.+) \|$", PAGE, re.M))


def test_every_table_and_column_is_documented_and_no_other():
    tables = {t.name: [c.name for c in t.columns] for t in AnalysisRow.metadata.sorted_tables}
    said = {name: re.findall(r"`(\w+)`", re.sub(r"\([^)]*\)", "", columns)) for name, columns in ROWS.items()}
    assert said == tables


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "runs.db"
    with open_store(f"sqlite:///{path}") as repository:
        run = repository.new_id()
        journalled(repository, short_run(run))
        for outcome in (Outcome.FAIL, Outcome.PASS):
            issued = calibration(repository.new_id(), run)
            record = repository.load_run(run)
            repository.save_result(RunResult(record, None, (), Verdict(outcome, "why"), issued, ""))
    return path


def test_the_questions_can_be_asked_as_printed(path):
    first, second = re.findall(r"```sql\n(.*?)```", PAGE, re.S)
    with sqlite3.connect(path) as database:
        assert database.execute(first).fetchall() == [("S-1", "L0", 1.01, 0.02)]
        assert database.execute(second).fetchall() == [("S-1", "bench-α", "pass", "why")]
