"""Rows outside of runs that cannot be read: commands pass over them, and db check names them and goes on."""

from dataclasses import replace

import pytest
from synced import NOW, Place, everything, judged, run_of
from tiers import rest_after

from cbsr_qa.app.gate.release_list import list_releases
from cbsr_qa.app.keeping import check_database
from cbsr_qa.domain.run.gate import Release
from cbsr_qa.domain.run.station import StationCheck

SHA = 64 * "b"


@pytest.fixture
def place(database_url):
    opened = Place(database_url)
    yield opened
    opened.engine.dispose()


def odd_moment(place):
    return "'infinity'" if place.url.startswith("postgresql") else "'x'"


def problems_of(place):
    done = check_database(place.url, None, lambda *_: None, quick=True)
    assert done.exit_code == (1 if done.result.problems else 0)
    return [problem.what for problem in done.result.problems]


def release(place, action="released", sha256=SHA):
    made = Release(place.store.new_id(), "recipe", "short", sha256, action, "Zoë", "so", NOW)
    place.store.releases.save(made)
    return made.release


def make_odd(place, name):
    place.change(f"UPDATE releases SET noted_at = {odd_moment(place)} WHERE release_id = '{name}'")


def test_a_release_that_cannot_be_read_is_none_and_is_named(place):
    first, second = release(place), release(place)
    make_odd(place, second)
    assert place.store.releases.read_latest("recipe", SHA).release == first
    listed = list_releases(place.url)
    (words,) = listed.result.unread
    assert words.startswith(f"releases (release_id {second}): noted_at holds")
    assert (listed.exit_code, [one.release for one in listed.result.releases]) == (1, [first])
    assert ("passed over", words) in listed.page.identity
    assert listed.result.releases[0].holds
    assert problems_of(place) == [words]
    make_odd(place, first)
    assert place.store.releases.read_latest("recipe", SHA) is None
    assert place.store.releases.read_latest("recipe", 64 * "c") is None


def test_a_withdrawal_that_cannot_be_read_withdraws(place):
    release(place)
    withdrawal = release(place, "withdrawn")
    make_odd(place, withdrawal)
    assert place.store.releases.read_latest("recipe", SHA).action == "withdrawn"
    assert not any(one.holds and one.action == "released" for one in list_releases(place.url).result.releases)
    later = release(place)
    assert place.store.releases.read_latest("recipe", SHA).release == later


def station_check(place, at=NOW):
    made = StationCheck(place.store.new_id(), "bench-α", "Zoë", at, "disc", SHA, (), (), ())
    place.store.stations.save_check(made)
    return made


def test_a_station_check_that_cannot_be_read_is_passed_over(place):
    first = station_check(place)
    second = station_check(place)
    place.change(f"UPDATE station_checks SET checked_at = {odd_moment(place)} WHERE check_id = '{second.check}'")
    assert place.store.stations.read_latest_check("bench-α").check == first.check
    assert place.store.stations.read_latest_golden_check("bench-α") is None
    assert any(words.startswith(f"station_checks (check_id {second.check}): ") for words in problems_of(place))


def test_a_reference_that_cannot_be_read_is_passed_over(place):
    everything(place.store)
    ((name,),) = place.said("SELECT reference FROM chart_references")
    (kept,) = place.store.charts.read_current("bench-α")
    again = replace(kept, reference=place.store.new_id(), location="A")
    place.store.charts.save([again])
    place.change(f"UPDATE chart_references SET made_at = {odd_moment(place)} WHERE reference = '{name}'")
    assert [one.reference for one in place.store.charts.read_current("bench-α")] == [again.reference]
    assert [one.reference for one in place.store.charts.read_all()] == [again.reference]
    assert any(words.startswith(f"chart_references (reference {name}): ") for words in problems_of(place))


@pytest.mark.parametrize("database_url", ["sqlite"], indirect=True)  # only SQLite takes bytes in a column of text
def test_an_odd_sensor_does_not_end_the_check(place):
    run = run_of(place.store)
    place.change("INSERT INTO sensors (serial, batch, sensor_type) VALUES (x'ff', 'B', 'disc')")
    place.change("UPDATE loads SET x_mm = 1.5")
    sensor, altered = check_database(place.url, None, lambda *_: None, quick=True).result.problems
    assert sensor.what.startswith("sensors (serial b'\\xff'): serial holds")
    assert altered.run == run


@pytest.mark.parametrize("number", rest_after(2, [2**31 - 1, 1, 1_000_000, 2**63 - 1]))
def test_a_row_in_the_order_of_runs_stops_no_run_and_is_named(place, number):
    if number > 2**31 and place.url.startswith("postgresql"):
        pytest.skip("the column holds no such number")
    runs = [run_of(place.store)]
    blob = "decode(repeat('31', 32), 'hex')" if place.url.startswith("postgresql") else "zeroblob(32)"
    place.change(f"INSERT INTO runs_begun VALUES ({number}, 'x', {blob})")
    runs += [run_of(place.store) for _ in range(3)]
    assert len(place.said("SELECT * FROM runs_begun")) == 5
    followed = [row[0] for row in place.said("SELECT before_run FROM runs ORDER BY run")]
    assert followed[-1] == runs[-2]
    assert any("run x" in words for words in problems_of(place))
    if number > 2_000_000:
        assert followed == [None, *runs[:-1]]
        assert f"runs_begun (number {number}) has a number that no run here can have" in problems_of(place)


def test_an_odd_cell_in_the_order_of_runs_stops_no_run(place):
    odd = "decode('31', 'hex')" if place.url.startswith("postgresql") else "x'31'"
    runs = [run_of(place.store)]
    place.change(f"INSERT INTO runs_begun VALUES (1, 'x', {odd})")
    runs += [run_of(place.store) for _ in range(2)]
    judged(place.store, runs[-1])
    assert [row[0] for row in place.said("SELECT before_run FROM runs ORDER BY run")] == [None, *runs[:-1]]
    assert any("runs_begun (number 1): sha256 holds" in words for words in problems_of(place))
