"""What was sent is compared again at both ends, and a run that is missing in between is named."""

import hashlib
import shutil
from dataclasses import replace
from datetime import date

import pytest
from stored_runs import SETTING, identity, journalled, short_run
from synced import assert_all_there, content, link_again, on_both, overridden, remove_run, run_of, sent
from tiers import rest_but_named

from cbsr_qa.domain.run.events import RunStarted
from cbsr_qa.store.sync.centre import refusals
from cbsr_qa.store.sync.queue import let_go, list_held, send_again, waiting

DAY = date(2026, 1, 1)

ALTERED = {
    "changed": ("UPDATE loads SET x_mm = 1.5", "loads (phase 0, load_index 0) was changed"),
    "removed": ("DELETE FROM unloaded_marks", "unloaded_marks (phase 0, mark 0) was removed"),
    "added": (
        "INSERT INTO unloaded_marks VALUES ((SELECT run FROM runs), 0, 7, 1.0)",
        "unloaded_marks (phase 0, mark 7) was added",
    ),
    "override": (
        "INSERT INTO verdict_overrides SELECT '01', run, max(analysis), 'pass', 'Zoë', 'so', CURRENT_TIMESTAMP"
        " FROM analyses GROUP BY run",
        "verdict_overrides (override_id 01) was added",
    ),
    "a link": ("DELETE FROM run_links WHERE number = 6", "link 6 in run_links is missing"),
}
#: The station reads its bytes again; those of the centre are read by db check there.
BYTES = {
    "frames": ("UPDATE frame_blocks SET voltages = zeroblob(9) WHERE block = 0 AND phase = 0", "frame block 0"),
    "samples": ("UPDATE sample_blocks SET sample_values = zeroblob(8) WHERE block = 0", "sample block 0"),
    "a file": ("UPDATE calibrations SET file = x'00'", "its file is not what was stored"),
}


def assert_quarantined(station, centre, done, run, why):
    assert [entry.item for entry in done.quarantined] == [run]
    assert (done.items, done.rows) == (0, 0)
    (entry,) = list_held(station.engine)
    assert why in entry.why
    assert [refused.run for refused in refusals(centre.engine)] == [run]


@pytest.mark.parametrize(("statement", "why"), rest_but_named(ALTERED | BYTES, "changed", "a link", "frames"))
def test_what_was_altered_at_the_station_after_it_was_sent_stops_the_run(full, centre, statement, why):
    sent(full, centre)
    before = content(centre.engine)
    run = overridden(full)
    full.change(statement)
    assert_quarantined(full, centre, sent(full, centre), run, why)
    assert content(centre.engine) == before


@pytest.mark.rest
@on_both
@pytest.mark.parametrize(("statement", "why"), ALTERED.values(), ids=ALTERED)
def test_what_was_altered_at_the_centre_stops_the_run(full, centre, statement, why):
    sent(full, centre)
    run = overridden(full)
    centre.change(statement)
    before = content(centre.engine)
    assert_quarantined(full, centre, sent(full, centre), run, f"at the centre, run {run}: {why}")
    assert content(centre.engine) == before


@pytest.mark.parametrize("where", ["station", "centre"])
def test_a_run_whose_links_were_computed_again_differs(full, centre, where):
    sent(full, centre)
    run = overridden(full)
    place = {"station": full, "centre": centre}[where]
    place.change("UPDATE loads SET x_mm = 1.5")
    link_again(place, run)
    assert_quarantined(full, centre, sent(full, centre), run, "differs from the centre's")


@pytest.mark.rest
@on_both
def test_all_that_was_sent_is_compared_from_a_day_on(station, centre):
    runs = [run_of(station.store, f"S-{number}") for number in range(4)]
    sent(station, centre)
    centre.change(f"UPDATE loads SET x_mm = 1.5 WHERE run = '{runs[1]}'")
    remove_run(centre, runs[2])
    assert (sent(station, centre).items, waiting(station.engine)) == (0, ())  # nothing is announced
    assert sent(station, centre, compare_since=date(2026, 11, 22)).compared == 0  # all began before
    done = sent(station, centre, compare_since=DAY)
    assert (done.runs, done.compared) == (1, 2)  # what the centre lost is sent again
    assert [(one.item, "did not have it" in one.why) for one in done.lost] == [(runs[2], True)]
    assert [entry.item for entry in done.quarantined] == [runs[1]]
    centre.change(f"UPDATE loads SET x_mm = 15.0 WHERE run = '{runs[1]}'")
    send_again(station.engine, runs[1])
    done = sent(station, centre)
    assert (done.items, done.compared, done.quarantined) == (0, 1, [])
    assert_all_there(centre.engine, station.engine)
    assert refusals(centre.engine) == []


@pytest.mark.parametrize(
    ("why", "statement", "where"),
    [
        ("release", "UPDATE releases SET outcome = 'withdrawn'", "station"),
        ("station check", "UPDATE station_check_lines SET outcome = 'failed'", "centre"),
        pytest.param("chart reference", "UPDATE chart_references SET mean = 7.0", "centre", marks=pytest.mark.rest),
    ],
)
def test_what_is_no_run_is_compared_too(full, centre, where, statement, why):
    sent(full, centre)
    {"station": full, "centre": centre}[where].change(statement)
    assert sent(full, centre).quarantined == []  # nothing announces it
    (entry,) = sent(full, centre, compare_since=DAY).quarantined
    assert entry.kind == why
    assert "differs from the centre's" in list_held(full.engine)[0].why


def test_a_run_under_way_is_compared_when_it_has_ended(station, centre):
    run = station.store.new_id()
    events = short_run(run)
    journal = journalled(station.store, events[:6])
    assert sent(station, centre).compared == 0
    journal(events[6])
    assert sent(station, centre).compared == 0
    for event in events[7:]:
        journal(event)
    assert sent(station, centre).compared == 1
    assert_all_there(centre.engine, station.engine)


def test_rows_that_the_centre_has_more_are_named(full, centre, place, tmp_path):
    full.engine.dispose()
    shutil.copy(tmp_path / "full.db", tmp_path / "older.db")
    overridden(full)
    sent(full, centre)
    done = sent(place("older"), centre)
    ((run,),) = full.said("SELECT run FROM runs")
    assert [one.run for one in done.added] == [run]
    assert f"the centre has 1 links more of run {run}" in done.added[0].why


@on_both
def test_a_run_that_was_removed_before_it_was_sent_is_named_at_both_ends(station, centre):
    runs = [run_of(station.store, f"S-{number}") for number in range(3)]
    remove_run(station, runs[1])
    done = sent(station, centre)
    assert (done.runs, [entry.item for entry in done.quarantined]) == (2, [runs[1]])
    (entry,) = list_held(station.engine)
    assert entry.why.startswith(f"the run before {runs[2]} (begun 2026-11-21 08:00 UTC) is missing: run {runs[1]}")
    (refused,) = refusals(centre.engine)
    assert (refused.run, refused.station, refused.why) == (runs[1], "bench-α", entry.why)
    problems, notes = centre.store.soundness.find_order_problems()
    assert problems == ()
    assert notes == (f"run {runs[1]} is not here: it was refused when it was sent, see cbsr-qa db sync --status",)
    send_again(station.engine, runs[1])
    assert [entry.item for entry in sent(station, centre).quarantined] == [runs[1]]
    let_go(station.engine, runs[1])
    assert sent(station, centre).quarantined == []
    assert refusals(centre.engine) == []


def test_a_run_that_was_removed_after_it_was_sent_is_named(station, centre):
    runs = [run_of(station.store, f"S-{number}") for number in range(3)]
    sent(station, centre)
    remove_run(station, runs[0])
    assert [entry.item for entry in sent(station, centre).quarantined] == [runs[0]]
    assert centre.store.soundness.find_order_problems() == ((), ())


@on_both
def test_the_last_run_removed_without_a_trace_is_known_to_the_centre(station, centre):
    runs = [run_of(station.store) for _ in range(2)]
    sent(station, centre)
    remove_run(station, runs[1], begun=True)
    assert station.store.soundness.find_order_problems() == ((), ())  # here, nothing says so
    assert "follows run" in sent(station, centre).notes[0]
    later = run_of(station.store)
    (note,) = sent(station, centre).notes
    assert note.startswith(f"the centre has run {runs[1]} (begun ")
    problems, (fork,) = centre.store.soundness.find_order_problems()
    assert problems == ()
    assert fork.startswith(f"runs {runs[1]} and {later} follow the same run {runs[0]}")


@pytest.mark.rest
def test_databases_that_went_on_from_one_copy_are_no_fault(station, centre, place, tmp_path):
    run_of(station.store)
    station.engine.dispose()
    shutil.copy(tmp_path / "station.db", tmp_path / "copy.db")
    copy = place("copy")
    for one in (station, copy, copy, station):
        run_of(one.store)
        assert sent(one, centre).quarantined == []
    for one in (station, copy):
        assert one.store.soundness.find_order_problems() == ((), ())
    problems, notes = centre.store.soundness.find_order_problems()
    assert (problems, len(notes)) == ((), 1)
    assert refusals(centre.engine) == []


def test_each_station_has_its_own_order_at_the_centre(place, centre):
    stations = [place(f"station-{number}") for number in range(2)]
    for station in (*stations, *reversed(stations)):
        run_of(station.store)
        assert sent(station, centre).notes == []
    assert centre.said("SELECT count(*) FROM runs_begun") == [(0,)]
    assert centre.store.soundness.find_order_problems() == ((), ())
    (first, _) = stations[1].said("SELECT run FROM runs ORDER BY run")
    remove_run(centre, first[0])
    ((gap,), notes) = centre.store.soundness.find_order_problems()
    assert (gap.run, notes) == (first[0], ())


def test_a_run_that_waits_for_a_refused_one_is_no_gap_at_the_centre(station, centre):
    first = run_of(station.store)
    station.change("UPDATE loads SET x_mm = 1.5")
    second = run_of_a_recipe(station.store, "short")  # which was another one in the first run, so it refers to that
    third = run_of_a_recipe(station.store, "long")
    done = sent(station, centre)
    assert ([one.item for one in done.quarantined], [one.item for one in done.blocked]) == ([first], [second])
    assert centre.said("SELECT run FROM runs") == [(third,)]
    problems, (note,) = centre.store.soundness.find_order_problems()
    assert (problems, note.startswith(f"run {second} is not here: it was refused")) == ((), True)
    station.change(f"UPDATE loads SET x_mm = 15.0 WHERE run = '{first}'")
    send_again(station.engine, first)
    sent(station, centre)
    assert_all_there(centre.engine, station.engine)
    assert refusals(centre.engine) == []


def run_of_a_recipe(store, recipe):
    """Store a run of a recipe with a content of its own."""
    run, configuration = store.new_id(), f'{{"recipe":{{"name":"{recipe}"}}}}'
    digest = hashlib.sha256(configuration.encode()).hexdigest()
    journal = store.open_journal(configuration=configuration, **SETTING)
    journal(RunStarted(replace(identity(run), recipe=recipe, configuration_digest=digest)))
    for event in short_run(run)[1:]:
        journal(event)
    return run
