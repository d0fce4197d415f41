"""The page on watching a station runs as printed, and the reference of JSON names every key there is."""

import re
import shlex
from pathlib import Path

import pytest
import sqlalchemy as sa
from test_gauge_command import fill, runs

from cbsr_qa.cli.main import run_guarded
from cbsr_qa.domain.results.fleet import RunSelection
from cbsr_qa.store.opening import open_store

DOCS = Path(__file__).parents[3] / "docs"

pytestmark = pytest.mark.rest


@pytest.fixture(scope="module")
def database(tmp_path_factory):
    """Six sensors on three stations, eleven times each."""
    path = tmp_path_factory.mktemp("pages") / "runs.db"
    fill(path, runs(trials=6), recipe="nine-locations")
    return path


def test_the_page_on_watching_a_station_runs_as_printed(database, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CBSR_QA_DATABASE", str(database))
    page = (DOCS / "how-to" / "watch-a-station.md").read_text()
    files = re.findall(r"`([\w-]+\.toml)`:\n\n```toml\n(.*?)```", page, re.S)
    for name, text in files:
        Path(name).write_text(text)
    commands = re.findall(r"^\$ cbsr-qa (.*)$", page, re.M)
    assert len(commands) == 7
    for command in commands:
        assert run_guarded(shlex.split(command)) == 0, command
        assert capsys.readouterr().out.strip()
    assert {path.name for path in tmp_path.iterdir()} == {"gain.toml", "golden.toml", "charts.html", "gauge.html"}


@pytest.mark.parametrize(
    "command",
    [
        "charts --station bench-a --reference-runs 30 --dry-run --json",
        "gauge --recipe nine-locations --json --reference S-01.force_gain=10 --reference S-02.force_gain=9",
    ],
)
def test_every_key_of_the_documents_is_documented(database, monkeypatch, capsys, command):
    import json

    monkeypatch.setenv("CBSR_QA_DATABASE", str(database))
    assert run_guarded(shlex.split(command)) == 0
    said = set(re.findall(r"`(\w+)", (DOCS / "reference" / "station-statistics.md").read_text()))
    assert keys(json.loads(capsys.readouterr().out)) - said == set()


def keys(document):
    if isinstance(document, dict):
        return set(document).union(*(keys(value) for value in document.values()))
    return set().union(*map(keys, document)) if isinstance(document, list) else set()


def test_the_end_of_a_run_asks_what_indices_answer(database):
    """Without them 10 000 runs take seconds: each query is looked up by station or analysis, never by name."""
    asked = []
    selection = RunSelection(stations=("bench-a",), recipe="nine-locations", checks=False, after="0", latest=20)
    with open_store(f"sqlite:///{database}") as store:
        sa.event.listen(sa.Engine, "before_cursor_execute", note := lambda *told: asked.append((told[2], told[3])))
        try:
            assert len(store.fleet.load_table(selection).runs) == 20
        finally:
            sa.event.remove(sa.Engine, "before_cursor_execute", note)
    engine = sa.create_engine(f"sqlite:///{database}")
    plans = []
    with engine.connect() as connection:
        for statement, given in asked:
            told = connection.exec_driver_sql(f"EXPLAIN QUERY PLAN {statement}", given).all()
            plans.append(" ".join(row[3] for row in told))
    assert any("ix_runs_station_run (station=? AND run>?)" in plan for plan in plans)
    assert any("sqlite_autoindex_measurements_1 (analysis=?)" in plan for plan in plans)
    assert not [plan for plan in plans if re.search(r"SCAN (runs|analyses|measurements|run_links)\b", plan)]
