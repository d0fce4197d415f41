"""Many loads of varying strength, against factorising afresh; and heads made of nested outlines."""

from functools import lru_cache
from itertools import pairwise

import numpy as np
import pytest
from drawn import drawn
from hypothesis import given, strategies as st

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.geometry.footprints import RoundFootprint
from cbsr_qa.domain.readings.loads import NINE_LOCATIONS_MM
from cbsr_qa.eit.forward.coverage import cover, cover_by_nested_outlines
from cbsr_qa.eit.forward.model import ForwardModel
from cbsr_qa.eit.loads import sheet as loaded_sheet
from cbsr_qa.eit.loads.family import WEAK, LoadFamily, Series
from cbsr_qa.eit.loads.sheet import LoadedSheet

# Loads that are there together are right to this part of the mean used reading; so says the simulated sheet.
TOGETHER = 1e-8


@pytest.fixture(scope="module")
def model(pin_sensor, model_of) -> ForwardModel:
    plain = model_of(pin_sensor(), size_mm=6.0, conductance=2e-4, contact=500.0)
    return ForwardModel(plain.mesh, plain.pattern, plain.conductance, plain.contact_impedance, order=2)


@pytest.fixture(scope="module")
def loaded(model) -> LoadedSheet:
    return LoadedSheet(model)


def family(model: ForwardModel, x_mm: float, y_mm: float, radius_mm: float = 6.5) -> LoadFamily:
    load = cover(model.elements, RoundFootprint(x_mm, y_mm, radius_mm))
    return LoadFamily(load.elements, lambda relative: load.change(model.conductance, relative))


@pytest.fixture(scope="module")
def nine(model) -> list[LoadFamily]:
    return [family(model, x, y) for x, y in NINE_LOCATIONS_MM]


@lru_cache
def loaded_four(model: ForwardModel) -> list[LoadFamily]:
    """Four loads of which each shares elements with the next."""
    return [family(model, x, y) for x, y in ((10.0, 5.0), (12.0, 5.0), (14.0, 9.0), (9.0, 4.0))]


def afresh(model: ForwardModel, loads: dict[LoadFamily, float], contacts: np.ndarray | None = None) -> np.ndarray:
    elements = np.concatenate([one.elements for one in loads])
    change = np.concatenate([one.change(strength) for one, strength in loads.items()])
    return model.with_values(contact_impedance=contacts).with_change_on(elements, change).voltages()


def error(model: ForwardModel, impedance: np.ndarray, exact: np.ndarray) -> float:
    """Largest error of a reading over the mean used one."""
    mean = np.abs(exact[model.pattern.usable()]).mean()
    return float(np.abs(model.readings(impedance) - exact).max() / mean)


@given(strength=st.floats(-0.5, 1.0))
@drawn(20)
def test_a_single_load_is_right_to_rounding_within_its_series_and_beyond(model, loaded, nine, strength):
    loads = {nine[1]: strength}
    (found,) = loaded.transfer_impedances([loads])
    assert error(model, found, afresh(model, loads)) < 1e-11


def test_a_single_load_answers_the_same_to_the_bit_whatever_was_loaded_before(model):
    places = [(12.0 + 3.1 * (k % 3), -7.0 + 2.7 * (k // 3)) for k in range(9)]
    loads = [{family(model, *place): -0.25} for place in places]
    fresh = [LoadedSheet(model).transfer_impedances([load])[0] for load in loads]
    for order in (range(8, -1, -1), (4, 0, 8, 3, 5, 1, 7, 2, 6)):
        used = LoadedSheet(model)
        for number in order:  # their rims share nodes
            np.testing.assert_array_equal(used.transfer_impedances([loads[number]])[0], fresh[number])


@given(strengths=st.lists(st.floats(-0.3, 0.4), min_size=9, max_size=9))
@drawn(15)
def test_nine_loads_together(model, loaded, nine, strengths):
    loads = dict(zip(nine, strengths, strict=True))
    (found,) = loaded.transfer_impedances([loads])
    assert error(model, found, afresh(model, loads)) < TOGETHER


@given(seed=st.integers(0, 1000))
@drawn(8)
def test_nine_loads_and_contacts_together(model, loaded, nine, seed):
    draw = np.random.default_rng(seed)
    contacts = model.contact_impedance * np.exp(0.3 * draw.standard_normal(len(model.contact_impedance)))
    loads = dict(zip(nine, draw.uniform(-0.2, 0.25, 9), strict=True))
    (found,) = loaded.transfer_impedances([loads], contacts)
    assert error(model, found, afresh(model, loads, contacts)) < TOGETHER
    (alone,) = loaded.transfer_impedances([{}], contacts)
    assert error(model, alone, model.with_values(contact_impedance=contacts).voltages()) < TOGETHER


def test_loads_that_share_elements_or_only_nodes(model, loaded):
    beside = [family(model, 0, 0), family(model, 3, 1), family(model, 19, 0), family(model, 0, 21)]
    assert np.intersect1d(beside[0].elements, beside[1].elements).size
    loads = dict(zip(beside, (0.2, 0.1, -0.1, 0.3), strict=True))
    (found,) = loaded.transfer_impedances([loads])
    assert error(model, found, afresh(model, loads)) < TOGETHER


@pytest.mark.rest
@pytest.mark.parametrize(("weakest", "strongest"), [(0.05, 0.3), (-0.8, -0.3), (1.0, 5.0)])
def test_loads_close_beside_each_other(model, weakest, strongest):
    """What they send each other is hardly smooth on their rims: the worst case for what is left out there."""
    draw, sheet, worst = np.random.default_rng(5), LoadedSheet(model), 0.0
    for _ in range(8):
        turns, first = draw.uniform(0, 2 * np.pi) + np.arange(4) * np.pi / 2, draw.uniform(-8, 8, 2)
        places = [first, *(first + draw.uniform(15.5, 19) * np.array([np.cos(t), np.sin(t)]) for t in turns)]
        loads = {family(model, *place): float(draw.uniform(weakest, strongest)) for place in places}
        (found,) = sheet.transfer_impedances([loads])
        worst = max(worst, error(model, found, afresh(model, loads)))
    assert worst < TOGETHER


@pytest.mark.rest
def test_memory_is_bounded_however_many_loads_overlap(model, monkeypatch):
    most = 2 << 20
    monkeypatch.setattr(loaded_sheet, "_MOST_BYTES", most)
    draw, sheet, seen = np.random.default_rng(5), LoadedSheet(model), set()
    for _ in range(30):
        loads = {family(model, *draw.uniform(-9, 9, 2)): 1e-4 for _ in range(4)}
        sheet.transfer_impedances([loads])
        seen.add(len(sheet._patches))
        for kept in (sheet._patches, sheet._links):
            # The newest is kept whatever it takes, and had been made room for before it was made.
            sizes = [one.nbytes for one in kept.values()]
            assert sum(sizes[:-1]) < most + max(sizes)
    assert len(sheet._patches) < 30
    assert max(seen) > 1


@given(strengths=st.lists(st.floats(-1, 1), min_size=4, max_size=4))
@drawn(15)
def test_residues_that_overlap_are_right_to_what_is_not_solved_for(model, loaded, strengths):
    """To second order: what is left out is less than what a change of 1e-7 does, whatever their signs."""
    shares = np.array(strengths) * WEAK / max(1.0, np.abs(strengths).sum())
    loads = dict(zip(loaded_four(model), shares.tolist(), strict=True))
    (found,) = loaded.transfer_impedances([loads])
    assert error(model, found, afresh(model, loads)) < TOGETHER


def test_a_load_on_an_electrode_while_contacts_change_is_solved_another_way(model, loaded):
    loads = {family(model, 47.0, 3.0): 0.2, family(model, 0, 0): 0.1}
    contacts = 1.2 * model.contact_impedance
    (found,) = loaded.transfer_impedances([loads], contacts)
    assert error(model, found, afresh(model, loads, contacts)) < TOGETHER
    (found,) = loaded.transfer_impedances([loads])
    assert error(model, found, afresh(model, loads)) < TOGETHER


def test_moments_that_follow_lose_what_is_of_third_order_in_what_changed(model, loaded, nine):
    """Halving what changes leaves an eighth of the error."""
    first = dict.fromkeys(nine, 0.2)
    errors = []
    for step in (0.2, 0.1, 0.05):
        later = {one: 0.2 - step * (1 + 0.1 * k) / 2 for k, one in enumerate(nine)}
        exact = afresh(model, later)
        _, found = loaded.transfer_impedances([first, later])
        errors.append(error(model, found, exact))
    assert errors[0] < 1e-4
    assert errors[1] < errors[0] / 6
    assert errors[2] < errors[1] / 6


def test_a_load_that_comes_from_nothing_within_a_frame_is_exact_beside_weak_ones(model, loaded, nine):
    """Only loads that change together and feel each other lose digits."""
    first = dict.fromkeys(nine, 1e-3) | {nine[3]: 0.0}
    later = dict.fromkeys(nine, 0.9e-3) | {nine[3]: 0.2}
    _, found = loaded.transfer_impedances([first, later])
    assert error(model, found, afresh(model, later)) < TOGETHER


def test_a_load_that_leaves_nothing_is_refused(model, loaded, nine):
    with pytest.raises(NumericsError, match="leaves"):
        loaded.transfer_impedances([{nine[0]: -1.0}])
    both = {family(model, 0, 0): -0.6, family(model, 2, 0): -0.6}
    with pytest.raises(NumericsError, match="leaves it with a conductance"):
        loaded.transfer_impedances([both])


@pytest.mark.parametrize("pole", [-0.5, 0.4, 2.0])
def test_a_series_is_exact_whatever_pole_is_near(pole):
    """f(s) = s/(s − p): found to 1e-12 within the reach, which stays clear of the pole, and exactly beyond."""
    series = Series(lambda s: np.array([s / (s - pole), 3 * s]))
    assert 0 < series.reach < abs(pole)
    for strength in np.linspace(-1, 1, 41)[::2] * 0.999:
        expected = np.array([strength / (strength - pole), 3 * strength])
        np.testing.assert_allclose(series(float(strength)), expected, rtol=1e-11, atol=0)


def test_a_series_of_what_is_not_smooth_is_the_exact_thing():
    series = Series(lambda s: np.array([abs(s)]))
    assert series.reach == 0
    assert series(-0.2) == 0.2


# --- nested outlines ---


def test_one_outline_alone_is_the_plain_cover(model):
    head = RoundFootprint(4.0, -3.0, 6.5)
    plain = cover(model.elements, head)
    nested = cover_by_nested_outlines(model.elements, head, (4.0, -3.0), np.array([1.0]), np.array([1.0]))
    np.testing.assert_array_equal(nested.elements, plain.elements)
    for relative in (0.1, -0.2, 1e-6):
        found, expected = (load.change(model.conductance, relative) for load in (nested, plain))
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-15 * model.conductance.max())


@given(relative=st.floats(-0.3, 0.5), size=st.floats(0.3, 0.95), weight=st.floats(0.1, 0.9))
@drawn(20)
def test_layers_keep_what_presses_in_all(model, relative, size, weight):
    """Along the outlines the mean over an element is the areas' mean of the layers, to rounding."""
    sizes, weights = np.array([1.0, size]), np.array([1 - weight, weight])
    centre = (1.0, 2.0)
    nested = cover_by_nested_outlines(model.elements, RoundFootprint(*centre, 6.5), centre, sizes, weights)
    areas = model.mesh.areas_mm2[nested.elements]
    points = model.elements.weights_mm2[nested.elements]
    along = relative * (nested.layers @ nested.levels)
    covered = np.pi * 6.5**2 * (weights * sizes**2).sum()
    assert points.sum(axis=1) == pytest.approx(areas)
    assert (along * points).sum() == pytest.approx(relative * covered, rel=1e-9, abs=1e-12)


def test_many_thin_layers_near_a_smooth_load(model):
    """A parabola of n nested heads: what readings still change by with n falls by four when n doubles."""

    def readings(count: int) -> np.ndarray:
        edges = np.arange(count, 0, -1) / count
        inner = np.append(edges[1:], 0.0)
        pressure = 2 - edges**2 - inner**2  # exact mean of 2 (1 − ρ²) over each annulus
        weights = np.diff(pressure, prepend=0.0)
        nested = cover_by_nested_outlines(model.elements, RoundFootprint(2.0, 1.0, 10.0), (2.0, 1.0), edges, weights)
        return model.with_change_on(nested.elements, nested.change(model.conductance, 0.2)).voltages()

    found = [readings(count) for count in (5, 10, 20, 40)]
    steps = [np.abs(a - b).max() for a, b in pairwise(found)]
    assert steps[1] < steps[0] / 3
    assert steps[2] < steps[1] / 3


def test_a_change_that_leaves_nothing_where_a_head_presses_hardest_is_refused(model):
    sizes, weights = np.array([1.0, 0.5]), np.array([0.5, 2.0])
    nested = cover_by_nested_outlines(model.elements, RoundFootprint(0.0, 0.0, 6.5), (0.0, 0.0), sizes, weights)
    with pytest.raises(NumericsError, match=r"2\.5 times as hard"):
        nested.change(model.conductance, -0.45)
    with pytest.raises(NumericsError, match="no positive conductance"):
        nested.change(model.conductance, float("nan"))
