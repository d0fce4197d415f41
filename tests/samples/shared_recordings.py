"""Fixtures: the recordings of the lab and the tank data, by name."""

import pytest
from shared_documents import document


@pytest.fixture(scope="session")
def board(shared):
    return lambda name: document(shared / "data" / "black_sensor" / f"{name}.csv")


@pytest.fixture(scope="session")
def tank(shared):
    folder = shared / "data" / "tank"
    return lambda name, **options: document(folder / name, **options)


@pytest.fixture(scope="session")
def skins(shared):
    """A real skin that a robot pressed, by name: ``no_pattern`` or ``parallel_lines``."""
    from pressed_sheets import skin

    return lambda name: skin(shared / "data" / "skins", name)
