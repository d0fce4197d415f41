"""The database reference names every table and view with every column, and its questions can be asked."""

import re
from pathlib import Path

import pytest
import sqlalchemy as sa
from exported_runs import measured
from stored_runs import calibration, journalled, short_run

from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.measurement import Verdict
from cbsr_qa.domain.results.run_result import RunResult
from cbsr_qa.store.engine import open_engine, parse_url, reading
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.tables.results import AnalysisRow
from cbsr_qa.store.views import VIEWS

PAGE = (Path(__file__).parents[2] / "docs" / "reference" / "database.md").read_text()
ROWS = dict(re.findall(r"^\| `(\w+)` \| [^|]+ \| (`.+) \|$", PAGE, re.M))


@pytest.fixture
def engine(database_url):
    """A run that was found to fail, then to pass, and overridden; each analysis issued a calibration."""
    with open_store(database_url) as repository:
        run = repository.new_id()
        journalled(repository, short_run(run))
        for outcome, error_mm in ((Outcome.FAIL, 9.0), (Outcome.PASS, 5.0)):
            issued = calibration(repository.new_id(), run)
            record, verdict = repository.runs.load(run), Verdict(outcome, "why")
            repository.analyses.save(RunResult(record, None, measured(error_mm, 0.1), verdict, issued, ""))
        repository.changes.override_verdict(run, Outcome.FAIL, operator="Ada", why="scratched")
    engine = open_engine(parse_url(database_url))
    yield engine
    engine.dispose()


def test_every_column_of_tables_and_views_is_documented_and_the_questions_can_be_asked_as_printed(engine):
    columns = {t.name: [c.name for c in t.columns] for t in AnalysisRow.metadata.sorted_tables}
    with reading(engine) as connection:
        columns |= {view: list(connection.execute(sa.text(f"SELECT * FROM {view}")).keys()) for view in VIEWS}
    said = {name: re.findall(r"`(\w+)`", re.sub(r"\([^)]*\)", "", text)) for name, text in ROWS.items()}
    assert said == columns
    with reading(engine) as connection:
        answers = [
            [tuple(row) for row in connection.exec_driver_sql(query)]
            for query in re.findall(r"```sql\n(.*?)```", PAGE, re.S)
        ]
        issued = connection.scalar(sa.text("SELECT max(calibration) FROM calibrations"))
    failed, spread, overridden, baseline = answers
    assert [(station, serial, reason) for station, serial, _, reason in failed] == [("bench-α", "S-1", "why")]
    assert spread == [("B7", "mm", 1, 5.0, 5.0, 5.0)]
    assert [row[:2] for row in overridden] == [("S-1", issued)]
    assert baseline == [("S-1", "L0", 1.01, 0.02)]
