"""Runs name the one before them: whatever is removed in between is named."""

import shutil
from datetime import UTC, datetime

import pytest
from stored_runs import journalled, short_run
from synced import Place, judged, remove_run, run_of

from cbsr_qa.app.keeping import check_database
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.store.chain.check import check_run, select_run
from cbsr_qa.store.engine import reading, writing
from cbsr_qa.store.tables.runs import Base

LATER = datetime(2100, 1, 1, tzinfo=UTC)
SOUND = ((), ())


@pytest.fixture
def place(database_url):
    opened = Place(database_url)
    yield opened
    opened.engine.dispose()


def words_of(place):
    problems, notes = place.store.soundness.find_order_problems()
    assert notes == ()
    return [gap.words for gap in problems]


def test_runs_follow_each_other(place):
    runs = [run_of(place.store, f"S-{number}") for number in range(3)]
    rows = place.said("SELECT run, before_run, before_link, before_sha256 FROM runs ORDER BY run")
    newest = "number = (SELECT max(number) FROM run_links AS n WHERE n.run = l.run)"
    last = {run: link for run, *link in place.said(f"SELECT run, number, sha256 FROM run_links AS l WHERE {newest}")}
    assert [tuple(row) for row in rows] == [
        (runs[0], None, None, None),
        (runs[1], runs[0], *last[runs[0]]),
        (runs[2], runs[1], *last[runs[1]]),
    ]
    assert place.store.soundness.find_order_problems() == SOUND


@pytest.mark.parametrize("begun", [False, True], ids=["", "with what says that it was begun"])
@pytest.mark.parametrize("number", [pytest.param(0, marks=pytest.mark.rest), 1])
def test_a_run_that_is_removed_between_others_is_named(place, number, begun):
    runs = [run_of(place.store, f"S-{serial}") for serial in range(3)]
    remove_run(place, runs[number], begun=begun)
    (words,) = words_of(place)
    assert words.startswith(f"the run before {runs[number + 1]} (begun 2026-11-21 08:00 UTC) is missing: run")
    assert f"{runs[number]} (begun 20" in words


def test_the_last_run_is_named_as_long_as_the_database_says_that_it_was_begun(place):
    runs = [run_of(place.store) for _ in range(2)]
    remove_run(place, runs[1])
    (words,) = words_of(place)
    assert words.startswith(f"run {runs[1]} (begun ")
    assert words.endswith("is missing: it was begun in this database")
    later = run_of(place.store)
    (words,) = words_of(place)
    assert words.startswith(f"the run before {later} ")


def test_several_missing_runs_are_named_each(place):
    runs = [run_of(place.store) for _ in range(5)]
    for run in runs[1:3]:
        remove_run(place, run)
    later, earlier = words_of(place)
    assert later.startswith(f"the run before {runs[3]} ")
    assert earlier.startswith(f"run {runs[1]} ")


def test_rows_that_were_there_when_the_next_run_began_cannot_be_cut_off(place):
    first = run_of(place.store)
    judged(place.store, first)
    run_of(place.store)
    place.store.changes.override_verdict(first, Outcome.FAIL, operator="Zoë", why="so")
    cut_off(place, first, "verdict_overrides")  # no run was begun after it
    assert place.store.soundness.find_order_problems() == SOUND
    cut_off(place, first, "warnings", "measurements", "analyses")
    (words,) = words_of(place)
    assert f"was another one, or had more rows, than run {first}" in words
    with reading(place.engine) as connection:
        assert check_run(connection, first).chained  # by itself, it looks like a run without a result


def cut_off(place, run, *tables):
    """Remove the newest rows of a run with their links, as if they had never been stored."""
    with writing(place.engine) as connection:
        for name in tables:
            table = Base.metadata.tables[name]
            connection.execute(table.delete().where(select_run(table, run)))
        kinds = ", ".join(f"'{name}'" for name in (*tables, *["figures"] * ("measurements" in tables)))
        connection.exec_driver_sql(f"DELETE FROM run_links WHERE run = '{run}' AND kind IN ({kinds})")


def test_a_run_in_the_place_of_another_one_is_named(place):
    first, _ = (run_of(place.store) for _ in range(2))
    remove_run(place, first, begun=True)
    journalled(place.store, short_run(first, "S-7"))
    assert f"was another one, or had more rows, than run {first}" in words_of(place)[0]


@pytest.mark.parametrize(
    ("number", "removed", "said"),
    [
        (1, "number = 7", "is another one by now: it was begun in this database"),
        (0, "number = 0", "was another one, or had more rows, than run"),
        (1, "number = 1", "has no chain, and run"),
    ],
)
def test_a_run_whose_chain_was_removed_is_no_run_of_before(place, number, removed, said):
    runs = [run_of(place.store) for _ in range(2)]
    place.change(f"DELETE FROM run_links WHERE run = '{runs[number]}'")
    place.change(f"UPDATE runs SET chain = NULL WHERE run = '{runs[number]}'")
    with writing(place.engine) as connection:
        connection.exec_driver_sql(f"DELETE FROM runs_begun WHERE {removed}")
    assert any(said in words for words in [*words_of(place), *place.store.soundness.find_misplaced_rows()])


def unchain(place):
    """Make the runs of a database look as if they were from before chains."""
    place.change("DELETE FROM runs_begun")
    place.change("DELETE FROM run_links")
    place.change("UPDATE runs SET chain = NULL, before_run = NULL, before_link = NULL, before_sha256 = NULL")


def test_after_a_run_without_a_chain_only_its_name_counts(place):
    old = run_of(place.store)
    unchain(place)
    new = run_of(place.store)
    assert place.said(f"SELECT before_run, before_link FROM runs WHERE run = '{new}'") == [(old, None)]
    assert place.store.soundness.find_order_problems() == SOUND
    place.change(f"UPDATE runs SET batch = 'B8' WHERE run = '{old}'")
    assert place.store.soundness.find_order_problems() == SOUND
    remove_run(place, old)
    assert old in words_of(place)[0]


def test_the_first_run_that_is_begun_where_runs_were_sent_follows_the_latest_of_them(place):
    runs = [run_of(place.store) for _ in range(2)]
    place.change("UPDATE runs SET before_run = NULL, before_link = NULL, before_sha256 = NULL")
    place.change("DELETE FROM runs_begun")
    new = run_of(place.store)
    assert place.said(f"SELECT before_run FROM runs WHERE run = '{new}'") == [(runs[1],)]
    remove_run(place, runs[1])
    assert len(words_of(place)) == 1
    remove_run(place, runs[0])  # what was sent here has nobody who names it
    assert len(words_of(place)) == 1


def test_a_resumed_and_an_archived_run_keep_their_place(tmp_path):
    place = Place(f"sqlite:///{tmp_path / 'runs.db'}")
    run = place.store.new_id()
    *events, last = short_run(run)
    journalled(place.store, events[:6])
    run_of(place.store)
    journalled(place.store, [events[0], *events[6:], last])
    judged(place.store, run)
    (one,) = place.store.archives.find_archivable(LATER)
    place.store.archives.archive(one, tmp_path / "kept", LATER)
    run_of(place.store)
    assert place.store.soundness.find_order_problems() == SOUND
    assert place.said("SELECT count(*) FROM runs_begun") == [(3,)]
    place.engine.dispose()


def test_a_restored_copy_goes_on_from_its_own_last_run(tmp_path):
    place = Place(f"sqlite:///{tmp_path / 'runs.db'}")
    first = run_of(place.store)
    place.engine.dispose()
    shutil.copy(tmp_path / "runs.db", tmp_path / "backup.db")
    run_of(place.store)
    place.engine.dispose()
    shutil.copy(tmp_path / "backup.db", tmp_path / "runs.db")
    again = run_of(place.store)
    assert place.said(f"SELECT before_run FROM runs WHERE run = '{again}'") == [(first,)]
    assert place.store.soundness.find_order_problems() == SOUND
    place.engine.dispose()


def test_db_check_names_the_gap_beside_the_run_after_it(place):
    runs = [run_of(place.store, f"S-{number}") for number in range(3)]
    assert check_database(place.url, None, lambda *_: None, quick=True).exit_code == 0
    remove_run(place, runs[1])
    done = check_database(place.url, None, lambda *_: None, quick=True)
    assert done.exit_code == 1
    sensor, gap = done.result.problems
    assert sensor.what == "sensors (serial S-1) has a batch or type of which no run tested it"
    assert (gap.run, gap.what) == (runs[2], words_of(place)[0])
