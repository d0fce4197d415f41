"""Checks of stations come back as they were stored; the latest one is found, also as of an earlier day."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from altered_runs import another_value, change
from sqlalchemy import select
from stored_runs import frames, identity, journalled, short_run
from tiers import rest_but_named

from cbsr_qa.domain.errors import RefusedError, StoreError
from cbsr_qa.domain.run.run import InstrumentIdentity
from cbsr_qa.domain.run.station import CheckOutcome, CheckResult, RingReadings, StationCheck, worst_check
from cbsr_qa.store.chain.run_documents import list_covered
from cbsr_qa.store.engine import reading, writing
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.seals import new_seal
from cbsr_qa.store.tables.records import StationCheckLineRow, StationCheckRow
from cbsr_qa.store.tables.runs import Base

AT = datetime(2026, 11, 22, 6, 30, tzinfo=UTC)
LINES = (
    CheckResult("identity", CheckOutcome.OK, said="2634B, serial 123, firmware 4.0.1", subject="source_meter"),
    CheckResult("gain error", CheckOutcome.FAILED, -1.5, "%", "−1 to 1 %", "adjust it", "", "reference ring"),
    CheckResult("golden sensor", CheckOutcome.NOT_DONE, remedy="--golden SERIAL"),
)
SMU = InstrumentIdentity(
    "source_meter", "keithley-2600", "2634B", "123", "4.0.1", False, "2027-03-31", (("address", "TCPIP::smu::5025"),)
)


def check(name, at=AT, station="bench-α", **changes):
    made = StationCheck(name, station, "Zoë", at, "disc-100mm", 64 * "a", (("cbsr-qa", "0.1.0"),), (SMU,), LINES)
    return replace(made, **changes)


@pytest.fixture
def repository(database_url):
    with open_store(database_url) as opened:
        yield opened


def test_a_check_comes_back_with_every_line(repository):
    journalled(repository, short_run(run := repository.new_id()))
    told = check(repository.new_id(), golden_run=run)
    ring = RingReadings(frames(0.0, 4, own_times=True), tuple(1000.0 + np.arange(16)))
    repository.stations.save_check(told, ring)
    assert repository.stations.read_latest_check("bench-α") == told
    assert told.outcome is CheckOutcome.FAILED
    back = repository.stations.read_ring(told.check)
    assert back.resistances_ohm == ring.resistances_ohm
    for name in ("time_s", "voltages", "flags", "reading_time_s"):
        assert getattr(back.frames, name).tobytes() == getattr(ring.frames, name).tobytes()
    assert (back.frames.unit, back.frames.current_A) == (ring.frames.unit, ring.frames.current_A)


def test_the_latest_check_of_this_station_is_found_as_of_any_moment(repository):
    assert repository.stations.read_latest_check("bench-α") is None
    old, new = check(repository.new_id()), check(repository.new_id(), AT + timedelta(days=2), operator="")
    other = check(repository.new_id(), AT + timedelta(days=3), station="bench-β")
    for one in (new, old, other):  # a database that was put together from two has them in any order
        repository.stations.save_check(one)
    assert repository.stations.read_latest_check("bench-α") == new
    assert repository.stations.read_latest_check("bench-α", before=AT + timedelta(days=1)) == old
    assert repository.stations.read_latest_check("bench-α", before=AT - timedelta(seconds=1)) is None
    assert repository.stations.read_ring(new.check) is None


def test_frames_of_a_ring_that_were_changed_are_refused(repository):
    told = check(repository.new_id())
    repository.stations.save_check(told, RingReadings(frames(0.0, 2), (1000.0,) * 16))
    with writing(repository._engine) as connection:
        connection.exec_driver_sql("UPDATE station_check_frames SET current_a = 5e-4")
    with pytest.raises(StoreError, match=f"station check {told.check} are not what was measured"):
        repository.stations.read_ring(told.check)


CHANGES = {
    **{
        f"{table}.{column.name}": f"UPDATE {table} SET {column.name} = {another_value(column)}"
        for table in ("station_checks", "station_check_lines", "station_check_frames")
        for column in list_covered(Base.metadata.tables[table])
        if column.name not in ("check_id", "station", "checked_at")  # it is another check then
    },
    "a line less": "DELETE FROM station_check_lines WHERE number = 1",
    "a line more": "INSERT INTO station_check_lines SELECT check_id, 9, subject, name, 'ok', value, unit, allowed,"
    " said, remedy FROM station_check_lines WHERE number = 0",
    "no ring": "DELETE FROM station_check_frames",
    "another seal": "UPDATE station_checks SET seal = 'sha256:' || substr(seal, -64)",
}


#: A cell of each table, a row less and more, the seal.
FIRST = (
    *("station_checks.operator", "station_check_lines.outcome", "station_check_frames.sha256", "a line less"),
    *("a line more", "no ring", "another seal"),
)


@pytest.mark.parametrize("key", rest_but_named({"signed": "a key of twenty-two let", "not signed": ""}, "signed"))
@pytest.mark.parametrize("statement", rest_but_named(CHANGES, *FIRST))
def test_a_check_that_was_altered_has_failed_and_says_why(tmp_path, monkeypatch, statement, key):
    if key:
        monkeypatch.setenv("CBSR_QA_SIGNING_KEY", key)
    elif "seal" in statement:
        pytest.skip("it is that seal")
    with open_store(f"sqlite:///{tmp_path / 'runs.db'}") as store:
        run = store.new_id()
        journalled(store, short_run(run))
        name = store.new_id()
        store.stations.save_check(check(name, golden_run=run), RingReadings(frames(0.0, 2), (1000.0,) * 16))
        assert store.stations.read_latest_golden_check("bench-α").sealed == ("signed" if key else "digest")
        assert [*store.soundness.find_seal_problems()] == []
        change(tmp_path / "runs.db", statement)
        for found in (
            store.stations.read_latest_check("bench-α"),
            store.stations.read_latest_golden_check("bench-α"),
        ):
            assert found.outcome is CheckOutcome.FAILED
            assert f"station check {name} was altered" in found.results[0].said
        assert len([*store.soundness.find_seal_problems()]) == 1


def test_a_seal_that_was_computed_again_without_the_key_is_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("CBSR_QA_SIGNING_KEY", "a key of twenty-two let")
    with open_store(f"sqlite:///{tmp_path / 'runs.db'}") as store:
        store.stations.save_check(check(store.new_id()))
        change(tmp_path / "runs.db", "UPDATE station_checks SET operator = 'Mallory'")
        tables = StationCheckRow, StationCheckLineRow
        with reading(store._engine) as connection:
            rows = [(one, row) for one in tables for row in connection.execute(select(one.__table__)).mappings()]
            forged = new_seal(connection, "another check", rows)  # signed, but for another
        change(tmp_path / "runs.db", "UPDATE station_checks SET seal = ?", forged)
        assert "was not signed with key" in store.stations.read_latest_check("bench-α").altered
        change(tmp_path / "runs.db", "UPDATE station_checks SET seal = NULL")  # as of before: the gate asks for more
        assert store.stations.read_latest_check("bench-α").sealed == "none"


def test_a_check_of_a_golden_run_that_is_not_stored_leaves_nothing_behind(repository):
    with pytest.raises(StoreError):
        repository.stations.save_check(check(repository.new_id(), golden_run=repository.new_id()))
    assert repository.stations.read_latest_check("bench-α") is None


def test_notes_of_an_instrument_are_part_of_a_runs_identity(repository):
    run = repository.new_id()
    told = replace(identity(run), instruments=(SMU, replace(SMU, role="load_cell", notes=())))
    events = short_run(run)
    journalled(repository, [replace(events[0], identity=told), *events[1:]])
    assert repository.runs.read_identity(run) == told


def test_a_check_is_as_good_as_its_worst_line_and_one_that_was_not_done_is_no_pass():
    ok, warned = CheckResult("a", CheckOutcome.OK), CheckResult("b", CheckOutcome.WARNING)
    skipped = CheckResult("c", CheckOutcome.NOT_DONE)
    assert worst_check((ok, warned, skipped)) is CheckOutcome.WARNING
    assert worst_check((ok, skipped)) is CheckOutcome.OK
    assert worst_check((skipped,)) is worst_check(()) is CheckOutcome.NOT_DONE
    with pytest.raises(RefusedError, match="nan is not a finite number"):
        CheckResult("gain", CheckOutcome.OK, float("nan"))
