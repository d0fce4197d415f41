"""Databases of stations, and a central one."""

import shutil

import pytest
from synced import Place, everything


@pytest.fixture(scope="module")
def template(tmp_path_factory):
    """A database with one of everything."""
    path = tmp_path_factory.mktemp("station") / "full.db"
    place = Place(f"sqlite:///{path}")
    everything(place.store)
    place.engine.dispose()
    return path


@pytest.fixture
def place(tmp_path):
    """Open databases by name; the files of SQLite."""
    places = []

    def made(name, url=""):
        places.append(Place(url or f"sqlite:///{tmp_path / name}.db"))
        return places[-1]

    yield made
    for one in places:
        one.engine.dispose()


@pytest.fixture
def station(place, request):
    """A station, of PostgreSQL where a test says so."""
    url = request.getfixturevalue("postgres_database") if getattr(request, "param", "") == "postgresql" else ""
    made = place("station", url)
    yield made
    made.engine.dispose()


@pytest.fixture
def full(template, tmp_path, place):
    """A station with one of everything."""
    shutil.copy(template, tmp_path / "full.db")
    return place("full")


@pytest.fixture
def centre(place, request):
    """A central database, of PostgreSQL where a test says so."""
    url = request.getfixturevalue("postgres_database") if getattr(request, "param", "") == "postgresql" else ""
    made = place("centre", url)
    yield made
    made.engine.dispose()
