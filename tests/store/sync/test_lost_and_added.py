"""What the centre had lost, and what somebody added there, is named, and ends a pass with exit code 1."""

from datetime import date

import pytest
import sqlalchemy as sa
from stored_runs import journalled, short_run
from synced import assert_all_there, content, judged, on_both, overridden, remove_run, run_of, sent, withdraw_verdict

from cbsr_qa.app.keeping import check_database
from cbsr_qa.app.sync import synchronise
from cbsr_qa.domain.errors import StoreError
from cbsr_qa.store.chain.check import select_run
from cbsr_qa.store.chain.run_documents import FIGURES, KEYS
from cbsr_qa.store.engine import writing
from cbsr_qa.store.tables.records import LinkRow
from cbsr_qa.store.tables.runs import Base

DAY = date(2026, 1, 1)


def cut_links(centre, run, left):
    """Remove the last links of a run at the centre with their rows, as a restored backup does."""
    with writing(centre.engine) as connection:
        last = sa.select(LinkRow.kind, LinkRow.document).where(LinkRow.run == run, LinkRow.number >= left)
        for kind, document in connection.execute(last).all():
            if kind != FIGURES:
                table = Base.metadata.tables[kind]
                keys = zip(KEYS[kind], document.split("/"), strict=True)
                same = [sa.cast(table.c[name], sa.Text) == value for name, value in keys]
                connection.execute(table.delete().where(select_run(table, run), *same))
        connection.execute(sa.delete(LinkRow).where(LinkRow.run == run, LinkRow.number >= left))


@on_both
def test_the_end_of_a_run_that_the_centre_lost_is_named_and_sent_again(station, centre):
    run = run_of(station.store)
    sent(station, centre)
    ((links,),) = station.said("SELECT count(*) FROM run_links")
    cut_links(centre, run, links - 1)
    (lost,) = sent(station, centre, compare_since=DAY).lost
    assert (lost.item, f"had confirmed {links} links of it and had {links - 1}" in lost.why) == (run, True)
    assert_all_there(centre.engine, station.engine)
    assert sent(station, centre, compare_since=DAY).lost == []
    assert station.said("SELECT * FROM outbox") == []


def test_a_loss_is_named_though_the_command_that_found_it_was_cut_off(station, centre, monkeypatch):
    run = run_of(station.store)
    sent(station, centre)
    remove_run(centre, run)

    def cut_off(*_):
        raise StoreError("cut off")

    with monkeypatch.context() as patch:
        patch.setattr("cbsr_qa.store.sync.send.store_parcel", cut_off)
        with pytest.raises(StoreError, match="cut off"):
            sent(station, centre, compare_since=DAY)
    assert [one.item for one in sent(station, centre).lost] == [run]


def test_what_the_centre_lost_of_a_run_under_way_is_named_in_any_pass(station, centre):
    run = station.store.new_id()
    events = short_run(run)
    journal = journalled(station.store, events[:9])
    assert sent(station, centre).lost == []
    remove_run(centre, run)
    for event in events[9:]:
        journal(event)
    assert [one.item for one in sent(station, centre).lost] == [run]
    assert_all_there(centre.engine, station.engine)


def test_what_was_never_sent_or_grew_is_not_called_lost(full, centre):
    assert sent(full, centre, compare_since=DAY).lost == []
    run = overridden(full)
    assert sent(full, centre, compare_since=DAY).lost == []
    assert full.said(f"SELECT count(*) FROM verdict_overrides WHERE run = '{run}'") == [(2,)]


@pytest.mark.parametrize(
    "table", [pytest.param("releases", marks=pytest.mark.rest), "chart_references", "station_checks"]
)
def test_what_is_no_run_and_was_lost_is_named(full, centre, table):
    sent(full, centre)
    if table == "station_checks":
        centre.change("DELETE FROM station_check_lines")
        centre.change("DELETE FROM station_check_frames")
    centre.change(f"DELETE FROM {table}")
    (lost,) = sent(full, centre, compare_since=DAY).lost
    assert lost.kind.replace(" ", "_") + "s" == table
    assert_all_there(centre.engine, full.engine)


def test_rows_of_a_run_without_a_chain_that_the_centre_lost_are_named(full, centre):
    ((run,),) = full.said("SELECT run FROM runs")
    full.change("DELETE FROM run_links")
    full.change("UPDATE runs SET chain = NULL")
    full.change("DELETE FROM runs_begun")
    assert sent(full, centre).lost == []
    centre.change("DELETE FROM verdict_overrides")
    assert [one.item for one in sent(full, centre, compare_since=DAY).lost] == [run]
    assert_unchained_alike(full, centre)


def assert_unchained_alike(station, centre):
    assert content(centre.engine) == content(station.engine)
    assert station.said("SELECT * FROM outbox") == []


@on_both
def test_rows_that_were_added_to_a_run_at_the_centre_are_named_whenever_it_is_compared(station, centre):
    run = run_of(station.store)
    judged(station.store, run)
    assert synchronise(station.url, centre.url).exit_code == 0
    withdraw_verdict(centre, run)
    assert check_database(centre.url, None, lambda *_: None, quick=True).exit_code == 0  # nobody can tell there
    for _ in range(2):
        done = synchronise(station.url, centre.url, compare_since=DAY)
        (added,) = done.result.added
        assert (done.exit_code, added.run) == (1, run)
        assert added.why.startswith(f"the centre has 1 links more of run {run}")
        assert "the centre has rows of runs that this database does not have" in done.page.banner.reason
        assert ("rows added", added.why) in done.page.identity
    assert station.said("SELECT * FROM outbox") == []


def test_a_row_without_a_link_beside_added_links_is_found_too(station, centre):
    run = run_of(station.store)
    sent(station, centre)
    withdraw_verdict(centre, run)
    centre.change("UPDATE loads SET x_mm = 1.5")
    (entry,) = sent(station, centre, compare_since=DAY).quarantined
    assert entry.item == run


@on_both
def test_a_run_in_the_name_of_a_station_that_does_not_have_it_is_named_when_all_is_compared(place, station, centre):
    run_of(station.store)
    other = place("other")
    run_of(other.store)
    run = run_of(other.store)
    for one in (station, other):
        sent(one, centre)
    done = synchronise(station.url, centre.url, compare_since=DAY)
    assert (done.exit_code, [one.run for one in done.result.added][-1]) == (1, run)
    assert "in the name of a station of this database" in done.result.added[0].why
    assert synchronise(station.url, centre.url).exit_code == 0  # compares nothing
    centre.change("UPDATE runs SET station = 'bench-β' WHERE before_run IS NOT NULL")
    assert [one.run for one in sent(station, centre, compare_since=DAY).added] != [run]
    assert sent(station, centre, compare_since=date(2099, 1, 1)).added == []
