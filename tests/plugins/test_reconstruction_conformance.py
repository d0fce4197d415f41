"""Every registered reconstruction, ours and whoever's, does what an image must do."""

import numpy as np
import pytest

from cbsr_qa.hookspecs import Kind
from cbsr_qa.plugins import Plugins, discover
from cbsr_qa.testing.elsewhere import images_elsewhere
from cbsr_qa.testing.reconstructions import (
    Tolerances,
    check_reconstruction,
    compare_elsewhere,
    elsewhere_readings,
)
from cbsr_qa.testing.targets import example_problem

_PLUGINS: Plugins = discover()
_METHODS = _PLUGINS.names(Kind.RECONSTRUCTION)

#: What a method needs more than others, and why.
_TOLERANCES: dict[str, Tolerances] = {}


def _factory(name):
    return _PLUGINS.factory(Kind.RECONSTRUCTION, name)


@pytest.fixture(scope="module")
def elsewhere() -> dict[str, np.ndarray]:
    """Images of all methods from one fresh process with two threads."""
    problem = example_problem()
    images = images_elsewhere([_factory(name) for name in _METHODS], problem, elsewhere_readings(problem), threads=2)
    return dict(zip(_METHODS, images, strict=True))


@pytest.mark.parametrize("name", _METHODS)
def test_it_conforms(name):
    done = check_reconstruction(_factory(name), tolerances=_TOLERANCES.get(name), elsewhere=False)
    assert len(done) == 9
    assert {checked.check for checked in done if not checked.applies} <= {"linearity", "noise propagation"}


@pytest.mark.parametrize("name", _METHODS)
def test_another_process_with_two_threads_sees_the_same(name, elsewhere):
    prepared = _factory(name)().prepare(example_problem())
    compare_elsewhere(prepared, elsewhere[name], tolerance=_TOLERANCES.get(name, Tolerances()).threads)
