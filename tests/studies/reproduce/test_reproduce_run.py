"""``reproduce paper`` from end to end on a short run: a simulated sheet gives back what it was given."""

import pytest
from made_once import value_made_once

from cbsr_qa.studies.reproduce import runs as reproduce_runs
from cbsr_qa.studies.reproduce.compare import within_digits
from cbsr_qa.studies.reproduce.runs import Job, simulate
from cbsr_qa.studies.reproduce.tables import force_error, least_force

pytestmark = pytest.mark.rest

_SHORT = {
    "uniform": {
        "noise figure": {"frames": 48, "trials": 1},
        "nine locations": {"strains_percent": [20.0], "trials": 1},
        "random loads": {"trials": 1},
    },
    "strip": {"press cycles": {"strains_percent": [10.0, 20.0, 30.0], "cycles": 2}},
}


@pytest.fixture(scope="module")
def sheet():
    return value_made_once("reproduced sheet", lambda: _simulated("uniform"))


@pytest.fixture(scope="module")
def strip():
    return value_made_once("reproduced strip", lambda: _simulated("strip"))


def _simulated(kind):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reproduce_runs, "_QUICK", _SHORT)
        return simulate(Job(kind, 8, quick=True))


def test_a_uniform_sheet_has_the_resistance_it_was_given_and_the_noise_figure_it_is_imaged_at(sheet):
    assert sheet.resistance.value == pytest.approx(18.1, rel=1e-3)
    assert sheet.noise_figure.value == pytest.approx(1.175, abs=0.17)
    assert sheet.noise_floor.count == 6
    assert within_digits(sheet.noise_floor.value, 5.97e-3, 5e-6, sheet.noise_floor.uncertainty + 1e-3)


def test_loads_are_seen_where_they_were_pressed_at_every_mask_place_and_random_load(sheet):
    assert [mask for mask, _ in sheet.by_mask] == [0.25, 0.5, 0.75, 0.85]
    assert [place for place, _ in sheet.by_place] == [f"L{k}" for k in range(9)]
    for _, (error, overlap, deviation) in (*sheet.by_mask, *sheet.by_place):
        assert error.value < 6.5  # the head's radius
        assert 50 < overlap.value <= 100
        assert deviation.value > 0
        assert error.count >= 20
    assert len(sheet.random) == 10
    assert sum(error.value is not None and error.value < 6.5 for error, _ in sheet.random) >= 8


def test_a_force_error_needs_presses_that_were_left_out_and_the_least_force_is_the_floors(sheet):
    assert force_error(sheet).value is None  # one trial leaves nothing out at L0
    floor = sheet.noise_floor.value
    assert least_force(sheet).value == pytest.approx(floor / (0.6 / 132.5) * 132.73e-3, rel=1e-3)


def test_a_strip_has_the_gauge_factor_and_modulus_it_was_given(strip):
    factor, modulus = strip.local_gauge_factor, strip.modulus
    assert abs(factor.value - 0.6) < 3 * factor.uncertainty
    assert modulus.value == pytest.approx(132.5, rel=2e-3)
    assert strip.gauge_factor.value < factor.value  # the head covers 20 of 35 mm between the pins
    assert {one.loading for one in strip.settlings} == {True, False}
