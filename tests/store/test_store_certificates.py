"""Certificates in the database: each number once, replaced and revoked under the chains of their runs."""

import sqlite3
from contextlib import closing
from dataclasses import replace

import pytest
from altered_runs import certificate
from stored_runs import calibration
from synced import Place, assert_all_there, judged, run_of, sent

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.store.opening import open_store


@pytest.fixture
def path(tmp_path):
    return tmp_path / "runs.db"


@pytest.fixture
def store(path):
    with open_store(f"sqlite:///{path}", durable=False) as opened:
        yield opened


def certified(store, serial="S-1"):
    """Store a run with a calibration; return a certificate of it that is not stored."""
    run = run_of(store, serial)
    issued = calibration(store.new_id(), run, serial)
    judged(store, run, issued=issued)
    return certificate(run, issued.calibration, number=f"LAB-{run}")


def test_a_certificate_comes_back_as_it_was_stored(store):
    one = replace(certified(store), signature='{"Δ": 1}\n')
    store.certificates.save(one)
    back = store.certificates.load(one.number)
    assert (back.issued, back.serial, back.withdrawals, back.withdrawn) == (one, "S-1", (), "")
    assert store.certificates.find("LAB-none") is None
    assert store.certificates.count(one.run) == 1
    with pytest.raises(StoreError, match="there is no sensor 'S-9' in this database"):
        store.certificates.list_all("S-9")
    assert store.runs.load(one.run).chain.chained


def test_a_run_has_one_certificate_that_stands(store):
    one = certified(store)
    store.certificates.save(one)
    other = replace(one, number="LAB-other")
    with pytest.raises(StoreError, match=f"certificate {one.number} of this run stands"):
        store.certificates.save(other)
    store.certificates.save(replace(other, replaces=one.number, why="name"))
    (gone,) = store.certificates.load(one.number).withdrawals
    assert (gone.replaced_by, gone.why, gone.operator) == ("LAB-other", "name", one.signatory)
    with pytest.raises(StoreError, match="does not stand: it was replaced by certificate LAB-other"):
        store.certificates.revoke(one.number, operator="Ada", why="so")


def test_a_certificate_of_an_earlier_run_is_replaced_under_its_own_chain(store):
    first, second = certified(store), certified(store)
    store.certificates.save(first)
    store.certificates.save(replace(second, replaces=first.number, why="calibrated again"))
    assert [one.replaced_by for one in store.certificates.load(first.number).withdrawals] == [second.number]
    for run in (first.run, second.run):
        assert store.runs.load(run).chain.chained
    assert [one.issued.number for one in store.certificates.list_all("S-1")] == [first.number, second.number]


def test_what_is_not_there_or_of_another_sensor_is_not_replaced_and_nothing_is_stored(store):
    mine, other = certified(store), certified(store, "S-2")
    store.certificates.save(other)
    with pytest.raises(StoreError, match="is of sensor S-2, not of S-1"):
        store.certificates.save(replace(mine, replaces=other.number, why="so"))
    with pytest.raises(StoreError, match="there is no certificate 'LAB-none'"):
        store.certificates.save(replace(mine, replaces="LAB-none", why="so"))
    assert store.certificates.count(mine.run) == 0
    assert store.certificates.load(other.number).withdrawals == ()


def test_a_number_is_given_once(store):
    mine, other = certified(store), certified(store, "S-2")
    store.certificates.save(mine)
    with pytest.raises(StoreError):
        store.certificates.save(replace(other, number=mine.number))
    assert store.certificates.load(mine.number).serial == "S-1"


def test_a_certificate_after_a_revocation_names_the_revoked_one(store):
    """ISO/IEC 17025:2017, 7.8.8.3."""
    one = certified(store)
    store.certificates.save(one)
    store.certificates.revoke(one.number, operator="Ada", why="wrong head")
    with pytest.raises(
        StoreError, match=f"certificate {one.number} of this run was revoked on .* by Ada: wrong head"
    ):
        store.certificates.save(replace(one, number="LAB-2"))
    store.certificates.save(replace(one, number="LAB-2", replaces=one.number, why="right head"))
    old = store.certificates.load(one.number)
    assert [gone.replaced_by for gone in old.withdrawals] == [None, "LAB-2"]
    assert "wrong head; replaced by certificate LAB-2 on" in old.withdrawn
    with pytest.raises(StoreError, match=r"does not stand: it was revoked on .*; replaced by certificate LAB-2"):
        store.certificates.save(replace(one, number="LAB-3", replaces=one.number, why="again"))


def test_after_a_later_run_took_over_the_earlier_one_may_be_certified_again(store):
    first, second = certified(store), certified(store)
    store.certificates.save(first)
    store.certificates.save(replace(second, replaces=first.number, why="calibrated again"))
    store.certificates.save(replace(first, number="LAB-again"))
    assert store.certificates.load("LAB-again").withdrawn == ""


def test_a_run_that_was_sent_here_is_certified_and_revoked_where_it_was_begun(tmp_path):
    """Numbers are counted per run: two databases that both counted would give the same one."""
    station, centre = (Place(f"sqlite:///{tmp_path / name}.db") for name in ("station", "centre"))
    one = certified(station.store)
    station.store.certificates.save(one)
    sent(station, centre)
    for attempt in (
        lambda: centre.store.certificates.save(replace(one, number="LAB-2", replaces=one.number, why="so")),
        lambda: centre.store.certificates.revoke(one.number, operator="Ada", why="so"),
        lambda: centre.store.certificates.check_allowed(one.run, None),
    ):
        with pytest.raises(StoreError, match="was begun in another database, of station 'bench-α', and sent here"):
            attempt()
    station.store.certificates.revoke(one.number, operator="Ada", why="so")
    sent(station, centre)
    assert centre.store.certificates.load(one.number).withdrawn.endswith("by Ada: so")
    assert_all_there(centre.engine, station.engine)


@pytest.mark.parametrize(
    ("statement", "said"),
    [
        ("update certificates set valid_until = '2999-01-01'", "certificates .* was changed"),
        ("update certificates set html = x'00'", "its page is not what was stored"),
        ("update certificates set dcc = x'00'", "its XML is not what was stored"),
        ("update certificate_withdrawals set why = 'no'", "certificate_withdrawals .* was changed"),
        ("delete from certificate_withdrawals", "certificate_withdrawals .* was removed"),
        ("update certificates set number = 'LAB-9'", "certificates .* was changed"),
    ],
)
def test_an_altered_certificate_is_refused_by_name(store, path, statement, said):
    one = certified(store)
    store.certificates.save(one)
    store.certificates.revoke(one.number, operator="Ada", why="so")
    with closing(sqlite3.connect(path)) as opened, opened:
        assert opened.execute(statement).rowcount == 1
    with open_store(f"sqlite:///{path}") as again, pytest.raises(StoreError, match=said):
        again.certificates.list_all()


@pytest.mark.parametrize("serial", [None, "S-1"])
def test_a_listing_names_certificates_whose_rows_were_removed(store, path, serial):
    one, other = certified(store), certified(store, "S-2")
    for issued in (one, other):
        store.certificates.save(issued)
    store.certificates.revoke(one.number, operator="Ada", why="so")
    with closing(sqlite3.connect(path)) as opened, opened:
        opened.execute("delete from certificate_withdrawals")
        opened.execute("delete from certificates where run = ?", [one.run])
    with open_store(f"sqlite:///{path}") as again:
        for attempt in (lambda: again.certificates.list_all(serial), lambda: again.certificates.find(one.number)):
            with pytest.raises(StoreError, match=f"run {one.run}: certificate.* was removed"):
                attempt()
        assert [found.issued.number for found in again.certificates.list_all("S-2")] == [other.number]


def test_a_number_says_whether_its_run_was_begun_here(store):
    one = certified(store)
    assert store.certificates.is_numbered_here(f"{one.number}-R1")
    assert not store.certificates.is_numbered_here("LAB-01989c3e-6d1f-7a42-b6d0-0e6f5a1f2c3d")
    assert not store.certificates.is_numbered_here("LAB-1")


def test_a_run_that_was_altered_is_not_certified_also_after_it_was_loaded(store, path):
    one = certified(store)
    head = store.runs.load(one.run).chain_head
    store.changes.override_verdict(one.run, "pass", operator="Ada", why="so")
    with closing(sqlite3.connect(path)) as opened, opened:
        opened.execute("update loads set x_mm = 1")
    with open_store(f"sqlite:///{path}") as again, pytest.raises(StoreError, match=r"loads .* was changed"):
        again.certificates.save(one, checked_link=head)
