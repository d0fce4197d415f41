"""The watching thread goes on whatever it meets, and says what that was."""

import sqlite3

import pytest
from served_line import until
from stored_lots import store_run

from cbsr_qa.store import open_store
from cbsr_qa.web import watching
from cbsr_qa.web.channel import ChannelClient
from cbsr_qa.web.stations import ServedStation
from cbsr_qa.web.watching import StationWatch, Watcher


@pytest.fixture
def url(tmp_path, monkeypatch):
    monkeypatch.setenv("CBSR_QA_VAR", str(tmp_path))
    return f"sqlite:///{tmp_path / 'runs.db'}"


@pytest.fixture
def watched(url):
    """Starts to watch stations of these names."""
    watchers = []

    def start(*names):
        stations = tuple(
            StationWatch(ServedStation(name, name, None, ()), ChannelClient(name, lambda: None)) for name in names
        )
        watchers.append(watcher := Watcher(stations, url, lambda names: None))
        watcher.start()
        return watcher, stations

    yield start
    for watcher in watchers:
        watcher.stop()
        assert not watcher.is_alive()


def test_a_damaged_run_of_one_station_hides_no_other_station(url, tmp_path, watched):
    with open_store(url) as store:
        damaged = store_run(store, "S-1", (), station="first")
        store_run(store, "S-2", (), station="second")
    with sqlite3.connect(tmp_path / "runs.db") as database:
        database.execute("update run_states set end = 'melted' where run = ?", (damaged,))
    watcher, (first, second) = watched("first", "second")
    until(lambda: second.snapshot, "the second station")
    assert (second.snapshot.serial, second.snapshot.trouble) == ("S-2", "")
    assert "melted" in first.snapshot.trouble
    assert watcher.trouble == ""


def test_what_nobody_has_foreseen_is_said_and_tried_again(watched, monkeypatch):
    failures = [ZeroDivisionError("nobody knew")]

    def sometimes(*arguments, **options):
        if failures:
            raise failures.pop()
        return open_store(*arguments, **options)

    monkeypatch.setattr(watching, "open_store", sometimes)
    watcher, (only,) = watched("only")
    until(lambda: "nobody knew" in watcher.trouble, "the trouble")
    watcher.wake()
    until(lambda: only.snapshot and not watcher.trouble, "the station")
