"""What a station stored arrives at the centre: every row once, through any failure, and nothing that was altered."""

import random
import shutil
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path

import later_schema
import pytest
import sqlalchemy as sa
import synced
from stored_runs import calibration, frames, journalled, short_run
from synced import assert_all_there, at_once_on_both, content, everything, judged, on_both, run_of, send, sent
from tiers import REST, rest_after

from cbsr_qa.domain.errors import LAST_UNRELEASED, StoreError
from cbsr_qa.domain.run.events import FramesTaken, RunEnded
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.store import archives
from cbsr_qa.store.chain.check import check_run
from cbsr_qa.store.engine import reading
from cbsr_qa.store.locks import sending_alone
from cbsr_qa.store.schema import HEAD, OLDEST_SENDER
from cbsr_qa.store.sync import parcels, storing
from cbsr_qa.store.sync.centre import refusals
from cbsr_qa.store.sync.queue import let_go, list_held, send_again, waiting

LATER = datetime(2100, 1, 1, tzinfo=UTC)


@at_once_on_both
def test_everything_arrives_once(full, centre):
    first = sent(full, centre)
    assert (first.items, first.runs, first.quarantined, first.blocked) == (4, 1, [], [])
    assert_all_there(centre.engine, full.engine)
    again = sent(full, centre)
    assert (again.items, again.rows) == (0, 0)


@on_both
@pytest.mark.parametrize("at_once", [pytest.param(1, marks=REST), 7])
def test_a_run_is_whole_up_to_a_link_after_every_parcel(full, centre, at_once, monkeypatch):
    monkeypatch.setattr(parcels, "MOST_LINKS", at_once)
    store = storing.store_parcel
    seen = []

    def checked(engine, parcel):
        store(engine, parcel)
        with reading(engine) as connection:
            seen.append(check_run(connection, parcel.run).chained)

    monkeypatch.setattr("cbsr_qa.store.sync.send.store_parcel", checked)
    sent(full, centre)
    assert len(seen) > 20 // at_once
    assert all(seen)
    assert_all_there(centre.engine, full.engine)


def test_a_run_under_way_is_sent_and_sent_again(station, centre):
    run = station.store.new_id()
    events = short_run(run)
    journal = journalled(station.store, events[:6])
    assert sent(station, centre).runs == 1
    assert content(centre.engine) == content(station.engine)
    assert waiting(station.engine) == ()
    for event in events[6:9]:
        journal(event)  # samples, a step, frames: nothing of it is announced
    assert [entry.item for entry in waiting(station.engine)] == [run]
    sent(station, centre)
    assert_all_there(centre.engine, station.engine)
    for event in events[9:]:
        journal(event)
    sent(station, centre)
    assert_all_there(centre.engine, station.engine)
    assert station.said("SELECT item FROM outbox") == []


def test_a_run_that_was_resumed_or_judged_after_it_was_sent_is_sent_again(station, centre):
    run = station.store.new_id()
    *events, last = short_run(run)
    journalled(station.store, [*events[:10], RunEnded(EndReason.ABORTED, "by Zoë", 40.0, ())])
    sent(station, centre)
    assert station.said("SELECT item FROM outbox") == []
    journalled(station.store, [events[0], *events[6:], last])
    sent(station, centre)
    assert_all_there(centre.engine, station.engine)
    judged(station.store, run)
    assert sent(station, centre).runs == 1
    assert_all_there(centre.engine, station.engine)


def test_an_announcement_is_stored_with_what_it_announces(station, monkeypatch):
    run_of(station.store)
    before = station.said("SELECT * FROM outbox")

    def fail(connection, *_):
        assert connection.scalar(sa.text("SELECT count(*) FROM outbox")) == 2
        raise ZeroDivisionError

    monkeypatch.setattr("cbsr_qa.store.runs.journal.note_changes", fail)
    with pytest.raises(ZeroDivisionError):
        run_of(station.store, "S-2")
    assert station.said("SELECT * FROM outbox") == before


def test_frames_add_no_rows_to_the_outbox(station):
    run = station.store.new_id()
    journal = journalled(station.store, short_run(run)[:6])
    before = station.said("SELECT * FROM outbox")
    journal(FramesTaken(0, frames(40.0, 4)))
    assert station.said("SELECT * FROM outbox") == before


def test_what_was_stored_and_not_confirmed_is_not_sent_twice(full, centre, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr("cbsr_qa.store.sync.send.confirm", lambda *_, **__: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            sent(full, centre)
    assert len(waiting(full.engine)) == 4
    assert sent(full, centre).rows < 20  # the check, the reference, the release
    assert_all_there(centre.engine, full.engine)


def test_an_altered_run_is_quarantined_and_the_queue_goes_on(station, centre):
    runs = [run_of(station.store, f"S-{number}") for number in range(3)]
    (was,) = station.said("SELECT x_mm FROM loads WHERE run = ?", runs[1])
    station.change(f"UPDATE loads SET x_mm = 1.5 WHERE run = '{runs[1]}'")
    done = sent(station, centre)
    assert (done.runs, [entry.item for entry in done.quarantined]) == (2, [runs[1]])
    (entry,) = list_held(station.engine)
    assert (entry.item, entry.state) == (runs[1], "quarantined")
    assert "loads (phase 0, load_index 0) was changed" in entry.why
    (refused,) = refusals(centre.engine)
    assert (refused.run, refused.station, refused.kind) == (runs[1], "bench-α", "run")
    assert len(refused.station_sha256) == len(refused.centre_sha256) == 64
    assert [run for (run,) in centre.said("SELECT run FROM runs ORDER BY run")] == [runs[0], runs[2]]
    assert sent(station, centre).items == 0
    station.change(f"UPDATE loads SET x_mm = {was[0]!r} WHERE run = '{runs[1]}'")
    send_again(station.engine, runs[1])
    assert sent(station, centre).runs == 1
    assert_all_there(centre.engine, station.engine)


@pytest.mark.parametrize(
    ("statement", "why"),
    rest_after(
        4,
        [
            (
                "UPDATE frame_blocks SET voltages = zeroblob(length(voltages)) WHERE block = 0 AND phase = 0",
                "frame block 0",
            ),
            ("UPDATE sample_blocks SET sample_values = zeroblob(8) WHERE block = 0", "sample block 0"),
            ("DELETE FROM unloaded_marks", "unloaded_marks (phase 0, mark 0) was removed"),
            ("UPDATE run_links SET document = '0/9' WHERE number = 6", "does not follow from the link before it"),
            ("DELETE FROM run_links WHERE number = 6", "link 6 in run_links is missing"),
            ("UPDATE phase_ends SET ended_s = 7 WHERE phase = 0", "phase_ends (phase 0) was changed"),
            ("UPDATE runs SET setting = 'none'", "runs.setting"),
            ("UPDATE runs SET chain = NULL", "run_links has 25 rows at the station and 0 at the centre"),
            ("INSERT INTO unloaded_marks VALUES ((SELECT run FROM runs), 0, 7, 1.0)", "unloaded_marks has 2 rows"),
        ],
    ),
)
def test_each_alteration_is_named(station, centre, statement, why):
    run_of(station.store)
    station.change(statement)
    sent(station, centre)
    (entry,) = list_held(station.engine)
    assert why in entry.why
    assert not centre.said("SELECT run FROM runs")
    assert len(refusals(centre.engine)) == 1


@pytest.mark.parametrize("spoil", [None, Path.unlink, pytest.param(lambda file: file.write_bytes(b"x"), marks=REST)])
def test_frames_archived_before_they_were_sent_are_read_from_their_file(station, centre, tmp_path, spoil):
    judged(station.store, run_of(station.store))
    before = content(station.engine)
    (one,) = station.store.archives.find_archivable(LATER)
    file = Path(station.store.archives.archive(one, tmp_path / "kept", LATER).file)
    if spoil is None:
        sent(station, centre)
        assert content(centre.engine) == before
    else:
        spoil(file)
        assert [entry.item for entry in sent(station, centre).quarantined] == [one.run]
        assert f"archived in {file}" in list_held(station.engine)[0].why


def test_an_archive_is_read_once_however_many_parcels_its_run_makes(station, centre, tmp_path, monkeypatch):
    judged(station.store, run_of(station.store))
    before = content(station.engine)
    (one,) = station.store.archives.find_archivable(LATER)
    station.store.archives.archive(one, tmp_path / "kept", LATER)
    read, parcelled = [], []
    monkeypatch.setattr(archives, "read_checked", counted(archives.read_checked, read))
    monkeypatch.setattr("cbsr_qa.store.sync.send.store_parcel", counted(storing.store_parcel, parcelled))
    monkeypatch.setattr(parcels, "MOST_BYTES", 2000)
    sent(station, centre)
    assert content(centre.engine) == before
    assert len([parcel for _, parcel in parcelled if "frame_blocks" in parcel.rows]) > 1
    assert len(read) == 1


def counted(function, calls):
    def called(*arguments):
        calls.append(arguments)
        return function(*arguments)

    return called


def test_another_run_of_the_same_name_is_quarantined(full, centre, place):
    sent(full, centre)
    other = place("other")
    run = full.said("SELECT run FROM runs")[0][0]
    journalled(other.store, short_run(run, "S-7"))
    done = sent(other, centre)
    assert [entry.item for entry in done.quarantined] == [run]
    (refused,) = refusals(centre.engine)
    assert "differs from the centre's" in refused.why
    assert_all_there(centre.engine, full.engine)


def test_an_older_copy_of_a_database_adds_nothing(full, centre, place, tmp_path):
    full.engine.dispose()
    shutil.copy(tmp_path / "full.db", tmp_path / "older.db")
    judged(full.store, full.said("SELECT run FROM runs")[0][0])
    sent(full, centre)
    older = place("older")
    done = sent(older, centre)
    assert (done.quarantined, done.rows) == ([], 0)
    assert_all_there(centre.engine, full.engine)
    judged(older.store, older.said("SELECT run FROM runs")[0][0])  # from here on the copies differ
    assert len(sent(older, centre).quarantined) == 1
    assert_all_there(centre.engine, full.engine)


def test_another_batch_of_a_sensor_is_quarantined(place, centre):
    early, late, other = place("early"), place("late"), place("other")
    for one in (early, late, other):
        run_of(one.store)
    other.change("UPDATE sensors SET batch = 'B8'")
    for one in (late, early, other):
        sent(one, centre)
    assert centre.said("SELECT * FROM sensors") == early.said("SELECT * FROM sensors")
    (entry,) = list_held(other.engine)
    assert "sensor S-1 has batch 'B7' at the centre, and 'B8' here" in entry.why
    assert len(centre.said("SELECT run FROM runs")) == 2


@on_both
@pytest.mark.rest
def test_of_calibrations_from_several_stations_one_is_valid(place, centre):
    stations = [place(f"station-{number}") for number in range(3)]
    issued = []
    for turn in range(2):
        for station in stations:
            run = run_of(station.store)
            issued.append(station.store.new_id())
            judged(station.store, run, issued=calibration(issued[-1], run))
        if turn == 0:
            sent(stations[1], centre)
    for station in reversed(stations):
        sent(station, centre)
    assert centre.said("SELECT calibration FROM v_calibrations") == [(max(issued),)]
    assert [one.calibration for one in centre.store.calibrations.list_issued("S-1")] == sorted(issued, reverse=True)


def test_what_refers_to_a_quarantined_run_waits_for_it(station, centre):
    first = run_of(station.store)
    run = everything(station.store, "S-2")
    station.change(f"UPDATE loads SET x_mm = 1.5 WHERE run = '{run}'")
    done = sent(station, centre)
    assert [entry.item for entry in done.quarantined] == [run]
    assert sorted(entry.kind for entry in done.blocked) == ["chart reference", "station check"]
    assert {entry.why for entry in waiting(station.engine)} == {
        f"it refers to run {run}, which the centre does not have"
    }
    assert centre.said("SELECT run FROM runs") == [(first,)]
    station.change(f"UPDATE loads SET x_mm = 15.0 WHERE run = '{run}'")
    let_go(station.engine, run)
    assert len(sent(station, centre).blocked) == 2
    send_again(station.engine, run)
    sent(station, centre)
    assert_all_there(centre.engine, station.engine)


def unchain(place):
    """Make the runs of a database look as if they were from before chains."""
    place.change("DELETE FROM runs_begun")
    place.change("DELETE FROM run_links")
    place.change("UPDATE runs SET chain = NULL")


@on_both
def test_runs_without_a_chain_are_compared_as_a_whole(full, centre, place):
    unchain(full)
    sent(full, centre)
    assert content(centre.engine) == content(full.engine)
    run = full.said("SELECT run FROM runs")[0][0]
    judged(full.store, run)
    sent(full, centre)
    assert content(centre.engine) == content(full.engine)
    full.change("UPDATE loads SET x_mm = 1.5")
    judged(full.store, run)
    (entry,) = sent(full, centre).quarantined
    assert entry.item == run
    assert "loads (phase 0, load_index 0)" in list_held(full.engine)[0].why


@on_both
def test_nothing_is_sent_to_a_centre_of_before_the_first_version(full, centre):
    centre.change("UPDATE alembic_version SET version_num = '0024'")
    with pytest.raises(StoreError, match=r"has schema 0024, from before version 0\.1\.0") as caught:
        sent(full, centre)
    assert LAST_UNRELEASED in caught.value.remedy
    assert centre.said("SELECT count(*) FROM runs") == [(0,)]


def test_programs_of_before_the_first_version_find_that_a_centre_does_not_take_their_rows():
    """They compare the oldest schema that it accepts with their own, as text."""
    assert all(f"{number:04}" < OLDEST_SENDER for number in range(1, 25))


@on_both
def test_a_row_that_the_centre_refuses_is_quarantined_with_its_run(station, centre):
    centre.change("CREATE UNIQUE INDEX only_one_run_of_a_sensor ON runs (serial)")
    runs = [run_of(station.store, serial) for serial in ("S-1", "S-1", "S-2")]
    done = sent(station, centre)
    assert (done.runs, [entry.item for entry in done.quarantined]) == (2, [runs[1]])
    assert "refuses a row" in list_held(station.engine)[0].why
    centre.change("DROP INDEX only_one_run_of_a_sensor")
    send_again(station.engine, runs[1])
    sent(station, centre)
    assert_all_there(centre.engine, station.engine)


@pytest.mark.postgres
@pytest.mark.parametrize("centre", ["postgresql"], indirect=True)
def test_a_value_too_long_for_its_column_is_quarantined(station, centre):
    run = station.store.new_id()
    journalled(station.store, short_run(run, 70 * "S"))  # SQLite has no lengths
    sent(station, centre)
    assert "too long" in list_held(station.engine)[0].why


@on_both
def test_an_older_station_sends_to_a_newer_centre_that_accepts_it(full, centre):
    centre.change("ALTER TABLE runs ADD COLUMN ambience TEXT")
    centre.change("CREATE TABLE lots (lot TEXT PRIMARY KEY)")
    centre.change("UPDATE alembic_version SET version_num = '9998'")
    sent(full, centre)
    centre.change(f"UPDATE alembic_version SET version_num = '{HEAD}'")
    assert_all_there(centre.engine, full.engine)
    judged(full.store, full.said("SELECT run FROM runs")[0][0])
    centre.change("UPDATE alembic_version SET version_num = '9999'")
    centre.change("UPDATE sync_accepts SET oldest_schema = '9999'")
    with pytest.raises(StoreError, match="accepts stations of schema 9999 or later"):
        sent(full, centre)
    assert len(waiting(full.engine)) == 1


def test_a_newer_station_waits_for_the_upgrade_of_the_centre(full, centre, tmp_path):
    with pytest.MonkeyPatch.context() as patch:
        later_schema.add_revision(patch, tmp_path)
        with pytest.raises(
            StoreError, match=f"schema {HEAD}, older than the station's .{later_schema.LATER}"
        ) as caught:
            sent(full, centre)
    assert "upgrade the central database first: cbsr-qa db upgrade" in caught.value.remedy
    sent(full, centre)
    assert_all_there(centre.engine, full.engine)


def test_a_database_is_no_centre_of_its_own(full):
    with pytest.raises(StoreError, match="is the station's own"):
        sent(full, full)


def test_one_process_sends_from_a_database(full, centre):
    with (
        sending_alone(full.engine, "Zoë on bench-α, process 7"),
        pytest.raises(StoreError, match="Zoë on bench-α, process 7 sends from"),
    ):
        sent(full, centre)
    assert sent(full, centre).items == 4


def test_a_full_centre_stops_the_queue_and_loses_nothing(full, centre):
    pages = centre.said("PRAGMA page_count")[0][0]

    def limit(connection, _):
        connection.execute(f"PRAGMA max_page_count = {pages + 2}")

    sa.event.listen(centre.engine, "connect", limit)
    centre.engine.dispose()
    with pytest.raises(StoreError, match="disk is full"):
        sent(full, centre)
    assert len(waiting(full.engine)) == 4
    sa.event.remove(centre.engine, "connect", limit)
    centre.engine.dispose()
    sent(full, centre)
    assert_all_there(centre.engine, full.engine)


@pytest.mark.postgres
@pytest.mark.parametrize("centre", ["postgresql"], indirect=True)
def test_a_read_only_centre_stops_the_queue(full, centre, postgres_server):
    name = centre.url.rpartition("/")[2]
    postgres_server.execute(f"ALTER DATABASE {name} SET default_transaction_read_only = on")
    centre.engine.dispose()
    with pytest.raises(StoreError, match="is read-only"):
        sent(full, centre)
    postgres_server.execute(f"ALTER DATABASE {name} SET default_transaction_read_only = off")
    centre.engine.dispose()
    sent(full, centre)
    assert_all_there(centre.engine, full.engine)


@pytest.mark.postgres
@pytest.mark.parametrize("how", ["killed", pytest.param("cut off", marks=REST)])
def test_killed_or_cut_off_anywhere_nothing_is_lost_or_doubled(template, tmp_path, postgres_server, how):
    points = random.Random(how).sample(range(10, 120), 3)
    with postgres_server.new_database() as url:
        strike = synced.killed if how == "killed" else synced.cutting(postgres_server, url)
        synced.struck_again(template, tmp_path / "struck.db", url, points, strike)


@pytest.mark.postgres
@pytest.mark.parametrize("centre", ["postgresql"], indirect=True)
def test_stations_that_send_at_once_do_not_disturb_each_other(place, centre):
    stations = [place(f"station-{number}") for number in range(4)]
    for station in stations:
        for _ in range(2):
            run = run_of(station.store)  # all of the same sensor
            judged(station.store, run, issued=calibration(station.store.new_id(), run))
    with ThreadPoolExecutor(len(stations)) as pool:
        list(pool.map(lambda one: send(one.url, centre.url), stations))
    assert [waiting(one.engine) for one in stations] == [()] * 4
    assert centre.said("SELECT count(*) FROM runs") == [(8,)]
    assert centre.said("SELECT count(*) FROM v_calibrations") == [(1,)]
