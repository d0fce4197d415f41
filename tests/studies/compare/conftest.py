"""Fixtures of the tests of ``cbsr-qa compare``: databases with a fleet in them, and without."""

import shutil

import pytest
from compared_fleets import fleet


@pytest.fixture
def url(tmp_path):
    return f"sqlite:///{tmp_path / 'fleet.db'}"


@pytest.fixture(scope="session")
def template(tmp_path_factory):
    file = tmp_path_factory.mktemp("compare") / "fleet.db"
    fleet(f"sqlite:///{file}")
    return file


@pytest.fixture
def two(template, tmp_path):
    """Database of its own with two batches on two stations, some sensors on both."""
    copied = shutil.copy(template, tmp_path / "two.db")
    return f"sqlite:///{copied}"
