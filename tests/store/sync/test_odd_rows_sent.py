"""One row that cannot be read is passed over and named, at the station and at the centre; everything else is sent."""

from datetime import UTC, date, datetime, timedelta

import pytest
from synced import on_both, run_of, sent
from tiers import rest_but_named

from cbsr_qa.app.keeping import check_database
from cbsr_qa.app.sync import sync_status, synchronise
from cbsr_qa.store.sync.centre import refusals
from cbsr_qa.store.sync.queue import backlog, waiting

DAY = date(2026, 1, 1)

REFUSED = "INSERT INTO sync_refusals VALUES ('run', 'R', 'bench', '', '', NULL, 'so', {moment})"
SETTLED = "INSERT INTO sync_settlements VALUES ('run', 'R', {moment})"
OUTBOX = {
    "a kind": ("'zz', 'R', 1, 0, CURRENT_TIMESTAMP, 'waiting', ''", "kind is 'zz'"),
    "a kind of bytes": ("x'ff', 'R', 1, 0, CURRENT_TIMESTAMP, 'waiting', ''", "kind holds b'\\xff'"),
    "an item": ("'run', x'ff', 1, 0, CURRENT_TIMESTAMP, 'waiting', ''", "item holds b'\\xff'"),
    "text": ("'run', CAST(x'ff' AS TEXT), 1, 0, CURRENT_TIMESTAMP, 'waiting', ''", "item holds b'\\xff'"),
    "a version": ("'run', 'R', 1e999, 0, CURRENT_TIMESTAMP, 'waiting', ''", "version holds inf"),
    "a moment": ("'run', 'R', 1, 0, 'x', 'waiting', ''", "noted_at holds 'x'"),
    "a state": ("'run', 'R', 1, 0, CURRENT_TIMESTAMP, 'zz', ''", "state is 'zz'"),
    "a reason": ("'run', 'R', 1, 0, CURRENT_TIMESTAMP, 'waiting', x'ff'", "why holds b'\\xff'"),
}


def problems_of(place):
    done = check_database(place.url, None, lambda *_: None, quick=True)
    assert done.exit_code == (1 if done.result.problems else 0)
    return [problem.what for problem in done.result.problems]


def odd_moment(place):
    return "'infinity'" if place.url.startswith("postgresql") else "'x'"


@pytest.mark.parametrize(("row", "said"), rest_but_named(OUTBOX, "a kind of bytes", "a version", "a moment"))
def test_an_odd_row_of_the_outbox_is_passed_over_and_named(station, centre, row, said):
    run = run_of(station.store)
    station.change(f"INSERT INTO outbox VALUES ({row})")
    assert [entry.item for entry in waiting(station.engine)] == [run]
    counted = backlog(station.engine)
    assert (counted.items, counted.unread) == (1, 1)
    done = synchronise(station.url, centre.url)
    assert (done.exit_code, done.result.runs, done.result.held) == (1, 1, ())
    (words,) = done.result.unread
    assert said in words
    assert ("passed over", words) in done.page.identity
    assert centre.said("SELECT run FROM runs") == [(run,)]
    status = sync_status(station.url, "")
    assert (status.exit_code, status.result.unread) == (1, (words,))
    assert problems_of(station) == [words]


#: Rows that can be read, in ways that are not usual.
UNUSUAL = [
    "'release', 'rélease', 1, 0, CURRENT_TIMESTAMP, 'waiting', ''",
    "'release', 'R', 1, 0, CURRENT_TIMESTAMP, 'waiting', 'the centre – not ours – is full'",
    "'release', 'R', 1, 0, '2026-01-01 00:00:00.250000', 'waiting', ''",
]


@pytest.mark.parametrize("row", UNUSUAL)
def test_a_row_that_is_not_usual_counts_as_any_other(station, row):
    run_of(station.store)
    station.change(f"INSERT INTO outbox VALUES ({row})")
    counted, entries = backlog(station.engine), waiting(station.engine)
    assert (counted.items, counted.unread) == (len(entries), 0) == (2, 0)
    oldest_h = (datetime.now(UTC) - min(entry.noted_at for entry in entries)).total_seconds() / 3600
    assert counted.age_h == pytest.approx(oldest_h, abs=0.1)


@pytest.mark.parametrize("station", ["sqlite", pytest.param("postgresql", marks=pytest.mark.postgres)], indirect=True)
def test_what_waits_is_counted_as_it_is_listed(station):
    """Waiting, held, sent, sent but grown since, and open with links that were not announced."""
    runs = [run_of(station.store, f"S-{number}") for number in range(4)]
    open_run = run_of(station.store, "S-9", events=3)
    old = datetime.now(UTC) - timedelta(hours=50)
    for run in [*runs, open_run]:
        station.change(f"UPDATE outbox SET noted_at = '{old:%Y-%m-%d %H:%M:%S}' WHERE item = '{run}'")
        old += timedelta(hours=1)
    station.change(f"UPDATE outbox SET state = 'quarantined' WHERE item = '{runs[0]}'")
    station.change(f"UPDATE outbox SET sent = version WHERE item = '{runs[1]}'")
    station.change(f"UPDATE outbox SET sent = 99, version = 99 WHERE item = '{open_run}'")
    station.change(f"DELETE FROM outbox WHERE item = '{runs[2]}'")
    assert [entry.item for entry in waiting(station.engine)] == [runs[3]]
    counted = backlog(station.engine)
    assert (counted.items, counted.unread) == (1, 0)
    assert counted.age_h == pytest.approx(47.0, abs=0.1)
    station.change(f"UPDATE outbox SET sent = 1, version = 1 WHERE item = '{open_run}'")
    assert sorted(entry.item for entry in waiting(station.engine)) == sorted([runs[3], open_run])
    assert backlog(station.engine).items == 2


@on_both
@pytest.mark.parametrize("statement", [REFUSED, SETTLED], ids=["refused", "settled"])
def test_an_odd_row_of_what_the_centre_refused_stops_nobody(station, centre, statement):
    run = run_of(station.store)
    centre.change(statement.format(moment=odd_moment(centre)))
    done = synchronise(station.url, centre.url)
    assert (done.exit_code, done.result.runs) == (1, 1)
    (words,) = done.result.unread
    assert words.startswith(f"at the centre, {statement.split()[2]} (kind run")
    assert centre.said("SELECT run FROM runs") == [(run,)]
    status = sync_status(station.url, centre.url)
    assert (status.exit_code, status.result.unread, status.result.refused) == (1, (words,), ())
    assert problems_of(centre) == [words.removeprefix("at the centre, ")]


@on_both
def test_a_settlement_that_cannot_be_read_settles_nothing(station, centre):
    run = run_of(station.store)
    station.change("UPDATE loads SET x_mm = 1.5")
    centre.change(SETTLED.replace("'R'", f"'{run}'").format(moment=odd_moment(centre)))
    assert [entry.item for entry in sent(station, centre).quarantined] == [run]
    assert [refused.item for refused in refusals(centre.engine)] == [run]


def test_what_cannot_be_read_at_the_station_is_quarantined_alone(full, centre):
    full.change("UPDATE releases SET noted_at = 'x'")
    done = sent(full, centre)
    assert [entry.kind for entry in done.quarantined] == ["release"]
    assert done.runs == len(full.said("SELECT run FROM runs"))
    assert sent(full, centre, compare_since=DAY).quarantined == []


def test_an_odd_name_is_not_announced_again(full, centre):
    sent(full, centre)
    full.change("UPDATE releases SET release_id = x'ff'")
    assert sent(full, centre, compare_since=DAY).unread == []


@on_both
def test_an_odd_link_at_the_centre_stops_its_run_alone(station, centre):
    first = run_of(station.store)
    sent(station, centre)
    odd = "decode('31', 'hex')" if centre.url.startswith("postgresql") else "x'31'"
    centre.change(
        "INSERT INTO run_links (run, number, kind, document, content_sha256, sha256)"
        f" VALUES ('{first}', 900, 'loads', '9/9', {odd}, {odd})"
    )
    second = run_of(station.store, "S-2")
    done = sent(station, centre, compare_since=DAY)
    assert [entry.item for entry in done.quarantined] == [first]
    assert centre.said("SELECT run FROM runs ORDER BY run") == [(first,), (second,)]


def test_an_odd_station_does_not_end_the_comparison(station, centre):
    run_of(station.store)
    second = run_of(station.store, "S-2")
    sent(station, centre)
    station.change(f"UPDATE runs SET station = x'ff' WHERE run = '{second}'")
    assert [entry.item for entry in sent(station, centre, compare_since=DAY).quarantined] == [second]
