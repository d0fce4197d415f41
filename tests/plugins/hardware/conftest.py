"""Benches of the three drivers that scan, emulated stations in a world of their own, and a stranger on a port."""

import pytest
from emulated_bench import EmulatedStation
from scanning_rig import Scanning
from simulated_setting import base_scene, world


@pytest.fixture(scope="module")
def one_world():
    return world(base_scene())


@pytest.fixture
def stations(one_world):
    """Start stations with these emulated instruments, and close them."""
    made = []

    def start(**instruments):
        made.append(EmulatedStation(one_world, **instruments))
        return made[-1]

    yield start
    for one in made:
        one.close()


@pytest.fixture
def bench():
    with Scanning() as one:
        yield one


@pytest.fixture
def hasty():
    """A bench that soon gives up waiting."""
    with Scanning(timeout_s=0.15) as one:
        yield one


class Stranger:
    """Another instrument: it answers bytes that hold a question, and nothing else."""

    def __init__(self, question, answer):
        self.question, self.answer = question, answer

    def receive(self, data):
        return self.answer if self.question in data else b""

    def misbehave(self, fault):
        raise AssertionError(fault)


@pytest.fixture
def stranger():
    """Serve another instrument on a port of a kind; its address."""
    ports = []

    def address(kind, question, answer):
        ports.append(kind("stranger"))
        ports[-1].serve(Stranger(question, answer))
        return ports[-1].address

    yield address
    for port in ports:
        port.close()
