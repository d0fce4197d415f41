"""Every registered reconstruction, ours and whoever's, does what an image must do."""

from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from typing import Any

import pytest
from tiers import rest_but

from cbsr_qa.config.loader import load_sensor_type
from cbsr_qa.eit.inverse.problem import imaging_problem
from cbsr_qa.plugin.discovery import Plugins, discover
from cbsr_qa.plugin.hooks import Kind
from cbsr_qa.testing.checked import Tolerances
from cbsr_qa.testing.reconstructions import check_reconstruction, compare_elsewhere, elsewhere_readings
from cbsr_qa.testing.targets import images_elsewhere

_PLUGINS: Plugins = discover()
_METHODS = _PLUGINS.names(Kind.RECONSTRUCTION)

#: Room a method needs more than others, and why.
_TOLERANCES: dict[str, Tolerances] = {
    # It solves on the sensor type's own forward mesh, which is symmetric to a per mille.
    "absolute-gauss-newton": Tolerances(turned_image=0.01, turned_place=1e-3),
    # Their mesh has no symmetry.
    "pyeit-jac": Tolerances(turned_image=0.3, turned_place=0.02),
    "pyeit-greit": Tolerances(turned_image=0.1, turned_place=0.01),
}
#: Options that make a method faster than its defaults.
_OPTIONS: dict[str, dict[str, Any]] = {
    "pyeit-jac": {"mesh_size": 0.14},
    "pyeit-greit": {"mesh_size": 0.14},
    "absolute-gauss-newton": {"mesh_size": 0.15},
    "total-variation": {"hyperparameter": 2.6e-8},
}


def _installed(name):
    return not name.startswith("pyeit") or find_spec("pyeit") is not None


def _factory(name):
    if not _installed(name):
        pytest.skip("pyEIT is an extra that is not installed")
    return partial(_PLUGINS.factory(Kind.RECONSTRUCTION, name), **_OPTIONS.get(name, {}))


#: One of each kind: a projection, a ridge, a truncation, and one that remembers frames; the others are slower.
_TELLING = {"linear-back-projection", "gauss-newton-noser", "truncated-svd", "temporal"}


@pytest.mark.parametrize("name", rest_but(_TELLING, _METHODS))
def test_it_conforms(name):
    done = check_reconstruction(_factory(name), tolerances=_TOLERANCES.get(name), elsewhere=False)
    assert len(done) == 10
    assert {checked.check for checked in done if not checked.applies} <= {
        "linearity",
        "noise propagation",
        "noise weighing",
    }


@pytest.mark.rest
def test_another_process_with_two_threads_sees_the_same():
    """All methods in one fresh process, for its start costs more than they do."""
    coarse = imaging_problem(load_sensor_type("disc-100mm").value, image_size_mm=8.0)
    problem, names = replace(coarse, measured=coarse.reference), [name for name in _METHODS if _installed(name)]
    everywhere = images_elsewhere([_factory(name) for name in names], problem, elsewhere_readings(problem), threads=2)
    for name, there in zip(names, everywhere, strict=True):
        allowed = _TOLERANCES.get(name, Tolerances()).threads
        compare_elsewhere(_factory(name)().prepare(problem), there, tolerance=allowed)
