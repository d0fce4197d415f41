"""What fewer loads would have told of a sheet whose response is known."""

from types import SimpleNamespace

import numpy as np
import pytest
from force_samples import HEAD, learned, line, pressed, smooth_response, somewhere

from cbsr_qa.analysis.run.fewer_places import _Loads, farthest_first, map_costs
from cbsr_qa.calibration.force.sheet_pose import AS_PLACED
from cbsr_qa.domain.errors import NumericsError

_PLACES = np.array([(12.0 * i + 6.0 * (j % 2), 10.5 * j) for j in range(-3, 4) for i in range(-3, 4)])
PLACES = _PLACES[np.hypot(*_PLACES.T) < 40]


def a_run(places_mm, force_N, seed=1, deviation=0.2, response=None, hold_s=30.0):
    """A run of one phase that lasts so long a load, and the force that was learned from it."""
    told = response or smooth_response(seed, deviation)
    data = pressed(np.random.default_rng(seed), told, places_mm, force_N, frames=400)
    loads = [
        SimpleNamespace(
            phase="grid", force_N=float(force), place_mm=(float(x), float(y)), record=SimpleNamespace(index=k)
        )
        for k, ((x, y), force) in enumerate(zip(places_mm, force_N, strict=True))
    ]
    phase = SimpleNamespace(name="grid", started_s=100.0, ended_s=100.0 + hold_s * len(loads), loads=loads)
    record = SimpleNamespace(
        phases=(phase,),
        indenter=HEAD,
        sensor_type=SimpleNamespace(radius_mm=50.0),
        material=SimpleNamespace(against_stress=line()),
    )
    found = SimpleNamespace(learned=learned(data), used=tuple(loads), sheet_pose=AS_PLACED)
    return SimpleNamespace(record=record), found


def test_places_and_time_are_those_of_the_loads_that_are_left():
    costs = map_costs(*a_run(PLACES, np.full(len(PLACES), 4.0)))
    count = len(PLACES)
    assert [cost.places for cost in costs] == [round(0.35 * count), round(0.5 * count), round(0.7 * count), count]
    assert [cost.loads for cost in costs] == [cost.places for cost in costs]
    assert [cost.station_s for cost in costs] == pytest.approx([30.0 * cost.places for cost in costs])
    assert costs[-1].seen is None


@pytest.mark.rest
def test_the_whole_map_states_what_the_calibration_states():
    run, found = a_run(PLACES, np.full(len(PLACES), 4.0))
    model = found.learned.model
    places = model.lattice.places_mm()[model.node.ravel() >= 0]
    inside = model.fits & (np.hypot(*places.T) <= np.hypot(*PLACES.T).max())
    expected = np.sqrt((model.log_response_stderr[inside] ** 2).mean())
    assert map_costs(run, found)[-1].stated == pytest.approx(expected, rel=1e-6)
    again = _Loads(run, found)
    assert again.cost(np.ones(len(PLACES), dtype=bool)).stated == pytest.approx(expected, rel=0.03)


@pytest.mark.rest
def test_fewer_places_tell_less_and_the_error_seen_is_about_what_is_stated():
    seen, expected = [], []
    for seed in range(6):
        costs = map_costs(*a_run(PLACES, np.full(len(PLACES), 4.0), seed))
        stated = [cost.stated for cost in costs]
        assert stated == sorted(stated, reverse=True)
        seen.append([cost.seen for cost in costs[:-1]])
        expected.append([cost.expected for cost in costs[:-1]])
    ratio = np.sqrt((np.square(seen).sum(axis=0)) / np.square(expected).sum(axis=0))
    assert ((ratio > 0.6) & (ratio < 1.6)).all()
    assert np.square(seen).mean(axis=0)[0] > 2 * np.square(seen).mean(axis=0)[-1]


def test_an_even_sheet_is_known_from_few_places():
    costs = map_costs(*a_run(PLACES, np.full(len(PLACES), 4.0), response=lambda places: np.ones(len(places))))
    assert all(cost.seen < 0.01 for cost in costs[:-1])


@pytest.mark.rest
def test_what_the_line_of_the_sensor_explains_is_no_error_of_the_map():
    """Loads from light to heavy, on a sensor with another intercept: ratios differ by tens of percent."""
    random = np.random.default_rng(4)
    places, force = np.repeat(PLACES, 2, axis=0), random.uniform(1.0, 5.0, 2 * len(PLACES))
    of = line()
    shifted = 0.04 / (of.slope.value * force / HEAD.area_mm2 * 1e3 + of.intercept.value)
    run, found = a_run(places, force, response=lambda _: 1 + shifted)
    assert found.learned.fitted_intercept
    assert np.nanstd(found.learned.ratio) > 0.03
    assert all(cost.seen < 0.02 for cost in map_costs(run, found) if cost.seen is not None)


def test_one_load_a_place_is_told_apart_from_all_of_them():
    run, found = a_run(np.repeat(PLACES, 3, axis=0), np.full(3 * len(PLACES), 4.0))
    once, whole = map_costs(run, found)[-2:]
    assert (once.places, once.loads) == (len(PLACES), len(PLACES))
    assert whole.loads == 3 * once.loads
    assert once.station_s == pytest.approx(whole.station_s / 3)
    assert whole.stated < once.stated < 3 * whole.stated


def test_few_places_leave_nothing_out():
    places = somewhere(np.random.default_rng(1), 4)
    assert map_costs(*a_run(places, np.full(4, 4.0))) == ()
    assert map_costs(SimpleNamespace(), SimpleNamespace(learned=None)) == ()


def test_places_are_chosen_the_farthest_first():
    line_mm = np.array([(x, 0.0) for x in (-40.0, -30.0, 0.0, 10.0, 40.0)])
    assert farthest_first(line_mm, 3) == [2, 0, 4]
    assert farthest_first(line_mm, 2, first=3) == [3, 0]
    with pytest.raises(NumericsError, match="cannot choose 6 places from 5"):
        farthest_first(line_mm, 6)
