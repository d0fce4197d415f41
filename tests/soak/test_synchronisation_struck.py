"""Synchronisation killed at fifty random points, and its connection cut at fifty others: all rows arrive once."""

import os
import random
import shutil

import pytest
import synced
from synced import everything

from cbsr_qa.store.opening import open_store

TRIALS = int(os.environ.get("CBSR_QA_SOAK_TRIALS", "50"))
SEED = int(os.environ.get("CBSR_QA_SOAK_SEED", "0"))

pytestmark = pytest.mark.postgres


@pytest.fixture(scope="module")
def station(tmp_path_factory):
    """Three runs with results, calibrations and the rest."""
    path = tmp_path_factory.mktemp("station") / "full.db"
    with open_store(f"sqlite:///{path}", durable=False) as store:
        for number in range(3):
            everything(store, f"S-{number}")
    return path


@pytest.fixture(scope="module")
def count(station, tmp_path_factory, postgres_server):
    """Points at which sending that database can be struck."""
    path = tmp_path_factory.mktemp("counted") / "full.db"
    shutil.copy(station, path)
    with postgres_server.new_database() as url:
        synced.opened(url).dispose()
        return synced.points(f"sqlite:///{path}", url)


@pytest.mark.parametrize("kind", ["killed", "cut off"])
@pytest.mark.parametrize("number", range(TRIALS))
def test_what_is_struck_arrives_once(station, count, tmp_path, postgres_server, kind, number):
    point = random.Random(f"{SEED}/{kind}/{number}").randrange(count)
    with postgres_server.new_database() as url:
        strike = synced.killed if kind == "killed" else synced.cutting(postgres_server, url)
        struck = synced.struck_again(station, tmp_path / "struck.db", url, [point], strike)
    assert struck == 1 or kind == "cut off"  # between two statements a cut may come too late to be noticed
