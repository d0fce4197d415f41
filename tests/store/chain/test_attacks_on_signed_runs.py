"""Somebody writes the database without the key: what he does to signed runs is named, or said to remain."""

import pytest
from synced import Place, judged, link_again, remove_run, replace_analysis, run_of, withdraw_verdict

from cbsr_qa.app.keeping import check_database
from cbsr_qa.app.shift.lists import ListRequest, list_runs
from cbsr_qa.app.shift.report import runs_outcome
from cbsr_qa.app.sync import synchronise
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.fleet import RunSelection
from cbsr_qa.store.opening import open_store

pytestmark = pytest.mark.rest

KEY = "a key that nobody else has"
NOT_SIGNED = "1 run is not signed with the key that is set: anyone who can write the database can have made them"


@pytest.fixture
def key(monkeypatch):
    monkeypatch.setenv("CBSR_QA_SIGNING_KEY", KEY)
    return monkeypatch


@pytest.fixture
def station(tmp_path, key):
    """A database with three signed runs, and their names."""
    url = f"sqlite:///{tmp_path / 'runs.db'}"
    with open_store(url) as store:
        runs = [run_of(store, "S-1") for _ in range(3)]
        for run in runs:
            judged(store, run)
    place = Place(url)
    yield place, runs
    place.engine.dispose()


def checked(place):
    return check_database(place.url, None, lambda *_: None, quick=False)


def unsign(place, run):
    """Have a run say that it was never signed, with a chain that is right."""
    place.change(f"UPDATE runs SET chain = 'sha256' WHERE run = '{run}'")
    place.change(f"UPDATE run_links SET mac = NULL WHERE run = '{run}'")
    link_again(place, run)


def follow(place, run, before):
    """Have a run follow another one than it did."""
    last = f"FROM run_links WHERE run = '{before}' ORDER BY number DESC LIMIT 1"
    place.change(
        f"UPDATE runs SET before_run = '{before}', before_link = (SELECT number {last}),"
        f" before_sha256 = (SELECT sha256 {last}) WHERE run = '{run}'"
    )
    link_again(place, run)


def remove_between(place, runs):
    remove_run(place, runs[1], begun=True)


def hide_the_gap(place, runs):
    remove_run(place, runs[1], begun=True)
    follow(place, runs[2], runs[0])


def change(place, runs):
    place.change("UPDATE measurements SET value = 1 WHERE analysis IN (SELECT max(analysis) FROM analyses)")
    link_again(place, runs[2])


def change_the_last_and_unsign(place, runs):
    place.change(f"UPDATE loads SET x_mm = 1 WHERE run = '{runs[2]}'")
    unsign(place, runs[2])
    place.change(f"DELETE FROM runs_begun WHERE run = '{runs[2]}'")


def change_another_and_unsign(place, runs):
    place.change(f"UPDATE loads SET x_mm = 1 WHERE run = '{runs[1]}'")
    unsign(place, runs[1])


def add_one(place, runs):
    run_of(place.store, "S-1")  # without the key


ATTACKS = {
    remove_between: "is missing: run",
    hide_the_gap: "was not signed with key",
    change: "was not signed with key",
    change_the_last_and_unsign: "is not signed, and run",
    change_another_and_unsign: "was another one, or had more rows, than run",
    add_one: "is not signed, and run",
}


@pytest.mark.parametrize(("attack", "said"), ATTACKS.items(), ids=[attack.__name__ for attack in ATTACKS])
def test_an_attack_is_named(station, attack, said):
    place, runs = station
    assert checked(place).exit_code == 0
    attack(place, runs)
    done = checked(place)
    assert done.exit_code == 1
    assert any(said in problem.what for problem in done.result.problems), done.result.problems


def test_the_last_run_can_be_removed_and_a_key_of_ones_own_shows_as_another(station, key):
    place, runs = station
    remove_run(place, runs[2], begun=True)
    assert checked(place).exit_code == 0  # what remains: SECURITY.md
    key.setenv("CBSR_QA_SIGNING_KEY", "a key of somebody else")
    with open_store(place.url) as store:
        run_of(store, "S-1")
    key.setenv("CBSR_QA_SIGNING_KEY", KEY)
    done = checked(place)
    assert (done.result.unsigned, done.page.remarks) == (1, (NOT_SIGNED,))


def test_links_that_were_computed_again_are_not_sent_as_signed(station, tmp_path):
    place, runs = station
    Place(f"sqlite:///{tmp_path / 'centre.db'}").engine.dispose()
    change(place, runs)
    done = synchronise(place.url, f"sqlite:///{tmp_path / 'centre.db'}")
    assert [(one.item, "was not signed with key" in one.why) for one in done.result.held] == [(runs[2], True)]


def test_a_verdict_that_another_login_added_to_a_signed_run_at_the_centre_is_refused(station, tmp_path, key):
    place, runs = station
    centre = Place(f"sqlite:///{tmp_path / 'centre.db'}")
    assert synchronise(place.url, centre.url).exit_code == 0
    key.delenv("CBSR_QA_SIGNING_KEY")
    unsign(centre, runs[2])
    centre.store.changes.override_verdict(runs[2], Outcome.FAIL, operator="Mallory", why="so")
    key.setenv("CBSR_QA_SIGNING_KEY", KEY)
    problems = checked(centre).result.problems
    assert any(runs[2] in problem.what and "is not signed" in problem.what for problem in problems)
    with open_store(place.url) as store:
        store.changes.override_verdict(runs[2], Outcome.FAIL, operator="Zoë", why="so")
    assert [one.item for one in synchronise(place.url, centre.url).result.held] == [runs[2]]
    centre.engine.dispose()


def test_a_run_in_the_name_of_another_station_is_told_apart_by_its_key_alone(station, tmp_path, key):
    place, runs = station
    centre, other = (Place(f"sqlite:///{tmp_path / name}.db") for name in ("centre", "other"))
    key.delenv("CBSR_QA_SIGNING_KEY")
    forged = run_of(other.store, "S-1")  # of the same station and sensor, stored elsewhere
    judged(other.store, forged)
    for url in (place.url, other.url):
        assert synchronise(url, centre.url).exit_code == 0
    assert checked(centre).exit_code == 0
    key.setenv("CBSR_QA_SIGNING_KEY", KEY)
    (problem,) = checked(centre).result.problems
    assert problem.what.startswith(f"run {forged} is not signed, and run {runs[0]} of its station")
    for one in (centre, other):
        one.engine.dispose()


@pytest.mark.parametrize("mac", [None, 64 * "0"], ids=["", "a false signature"])
@pytest.mark.parametrize("add", [withdraw_verdict, replace_analysis])
def test_rows_with_links_that_are_not_signed_are_refused_at_the_centre(station, key, tmp_path, add, mac):
    place, runs = station
    centre = Place(f"sqlite:///{tmp_path / 'centre.db'}")
    assert synchronise(place.url, centre.url).exit_code == 0
    key.delenv("CBSR_QA_SIGNING_KEY")
    add(centre, runs[1], mac)
    assert list_altered(centre) == ([runs[1]] if mac is None else [])  # only who has the key can tell a false one
    key.setenv("CBSR_QA_SIGNING_KEY", KEY)
    assert list_altered(centre) == [runs[1]]
    problems = checked(centre).result.problems
    assert [problem.run for problem in problems] == [runs[1]]
    assert ("is not signed, unlike its run" if mac is None else "was not signed with key") in problems[0].what
    centre.engine.dispose()


def list_altered(place):
    """Return the runs that a list marks."""
    with open_store(place.url) as store:
        done = runs_outcome(list_runs(store, ListRequest(RunSelection())))
    altered = [line.run for line in done.result.runs if line.verdict == "altered"]
    assert done.exit_code == (1 if altered else 0)
    return altered
