"""The sequence ``given-loads``: a list of presses, in its order, with every mistake named."""

from itertools import pairwise

import numpy as np
import pytest

from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.plan.steps import FindSurface, Press
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.station.setup import configure, plan_of
from cbsr_qa_plugins.sequences.places import GivenLoadsSequence

_POLAR = {"radius_mm": 10.0, "angle_deg": 90.0, "strain_percent": 20.0}
_PLAIN = {"x_mm": -3.0, "y_mm": 4.0, "strain_percent": 5.0}


def _pressed(sequence):
    return [step.load for step in sequence.steps(None) if isinstance(step, Press)]


def test_loads_are_pressed_in_their_order_once_a_trial_at_the_places_they_name():
    loads = _pressed(GivenLoadsSequence(loads=[_POLAR, _PLAIN], trials=2, label="P"))
    assert [(one.label, one.trial) for one in loads] == [("P0", 0), ("P1", 0), ("P0", 1), ("P1", 1)]
    assert (loads[0].x_mm, loads[0].y_mm, loads[0].strain) == (0.0, 10.0, 0.2)
    assert (loads[1].x_mm, loads[1].y_mm, loads[1].strain) == (-3.0, 4.0, 0.05)


def test_the_surface_is_found_at_every_place_once():
    steps = list(GivenLoadsSequence(loads=[_POLAR, _PLAIN, _POLAR], trials=3).steps(None))
    assert len([step for step in steps if isinstance(step, FindSurface)]) == 2
    assert not [
        s for s in GivenLoadsSequence(loads=[_POLAR], find_surface=False).steps(None) if type(s) is FindSurface
    ]


@pytest.mark.parametrize(
    ("load", "named"),
    [
        ({"x_mm": 1.0, "strain_percent": 5.0}, r"loads\[2\]"),
        ({**_POLAR, "x_mm": 1.0}, r"loads\[2\]"),
        ({"radius_mm": 1.0, "angle_deg": 0.0}, r"loads\[2\]"),
        ({**_PLAIN, "strain_percent": 0.0}, "strain_percent"),
        ({**_POLAR, "radius_mm": -1.0}, "radius_mm"),
        ("L0", r"loads\[2\] is 'L0'"),
    ],
)
def test_a_load_without_a_place_or_with_two_is_refused_by_number(load, named):
    with pytest.raises(ConfigError, match=named) as caught:
        GivenLoadsSequence(loads=[_PLAIN, load])
    assert caught.value.remedy.startswith("it must be a")


def test_the_recipe_of_the_paper_presses_its_random_loads_where_it_says():
    from cbsr_qa.studies.reproduce.reproduce import read_published

    configuration = configure("simulated", "paper", sensor_type=None, material=None, seed=1)
    sequence = next(p.sequence for p in plan_of(configuration, discover()).phases if p.name == "random loads")
    loads, rows = _pressed(sequence), read_published()["table5_random_E_CoM_mm"]["rows"]
    assert len(loads) == 3 * len(rows) == 30
    for load, (radius_mm, angle_deg, percent, *_) in zip(loads, rows * 3, strict=True):
        assert np.hypot(load.x_mm, load.y_mm) == pytest.approx(radius_mm, abs=0.01)
        assert np.degrees(np.arctan2(load.y_mm, load.x_mm)) % 360 == pytest.approx(angle_deg, abs=0.2)
        assert load.strain == pytest.approx(percent / 100)
    assert all(a.trial <= b.trial for a, b in pairwise(loads))
