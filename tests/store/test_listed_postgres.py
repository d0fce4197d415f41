"""Lists on PostgreSQL: runs that follow each other are selected by a range, others by their names."""

from datetime import date

import numpy as np
import pytest
import sqlalchemy as sa
from stored_lots import judged, measured, store_run
from tiers import rest_but_named

from cbsr_qa.domain.errors import StoreError
from cbsr_qa.domain.results.fleet import RunSelection
from cbsr_qa.store.engine import open_engine, parse_url, writing
from cbsr_qa.store.opening import open_store


@pytest.mark.rest
@pytest.mark.postgres
def test_many_runs_are_listed_and_the_altered_one_is_marked(postgres_database):
    random = np.random.default_rng(1)
    with open_store(postgres_database, durable=False) as store:
        values = judged(measured(random, random.standard_normal(3)))
        names = [store_run(store, f"S-{n % 2}", values) for n in range(44)]
        assert [one.run for one in store.lists.read_runs() if not one.altered] == names
        assert [one.run for one in store.lists.read_runs(RunSelection(serials=("S-1",))) if not one.altered] == names[
            1::2
        ]
        engine = open_engine(parse_url(postgres_database))
        with writing(engine) as connection:
            changed = sa.text("UPDATE analyses SET outcome = 'fail' WHERE run = :run")
            assert connection.execute(changed, {"run": names[7]}).rowcount == 1
        engine.dispose()
        for selection in (RunSelection(), RunSelection(serials=("S-1",))):
            assert [one.run for one in store.lists.read_runs(selection) if one.altered] == [names[7]]


ODD = {
    "another station": "station = 'line-9'",
    "another day": "started_at = '2001-01-01'",
    "a day of no calendar": "started_at = 'infinity'",
    "deep JSON": f"software = '{'[' * 3000}{']' * 3000}'",
}


@pytest.mark.postgres
@pytest.mark.parametrize("cell", rest_but_named(ODD, "a day of no calendar"))
def test_a_run_that_was_moved_out_of_a_list_or_cannot_be_read_is_listed_as_altered(postgres_database, cell):
    random = np.random.default_rng(1)
    with open_store(postgres_database, durable=False) as store:
        values = judged(measured(random, random.standard_normal(3)))
        names = [store_run(store, f"S-{n}", values) for n in range(3)]
        engine = open_engine(parse_url(postgres_database))
        with writing(engine) as connection:
            connection.execute(sa.text(f"UPDATE runs SET {cell} WHERE run = :run"), {"run": names[1]})
        engine.dispose()
        for selection in (RunSelection(), RunSelection(stations=("bench-α",), since=date(2002, 1, 1))):
            listed = store.lists.read_runs(selection)
            assert [one.run for one in listed] == names
            assert [one.run for one in listed if one.altered] == [names[1]]
        with pytest.raises(StoreError, match=names[1]):
            store.runs.load(names[1])
