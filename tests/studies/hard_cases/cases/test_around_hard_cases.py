"""Searches round the hard cases: whatever is accepted is right to its condition number, whatever is not is named."""

from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from drawn import drawn
from hypothesis import event, example, given, strategies as st
from scipy import linalg

from cbsr_qa.eit.forward.value_range import ValueRangeError
from cbsr_qa.eit.inverse.dual import dual_matrix, dual_spectrum
from cbsr_qa.studies.hard_cases.case import Answer, condition_bound
from cbsr_qa.studies.hard_cases.cases.forward import _sensitivities, compare_fifty_digits
from cbsr_qa.studies.hard_cases.cases.forward_loads import compare_load
from cbsr_qa.studies.hard_cases.cases.readings import _image_in_units, _noise, _offset
from cbsr_qa.studies.hard_cases.cases.reconstruction import _lasting, ridge_condition
from cbsr_qa.studies.hard_cases.exact import exact_image
from cbsr_qa.studies.hard_cases.sheets import (
    exact_readings,
    inclusion,
    islands,
    relative_error,
    scatter_conductance,
    small_model,
)

#: What rounding does to readings where every element has a conductance of its own, over eight decades.
_SCATTERED = 1e-12

_FEW = drawn(15)


def check(answer: Answer) -> None:
    assert np.isfinite(answer.error)
    assert answer.error <= answer.bound, answer


@pytest.mark.rest
@given(
    kind=st.sampled_from([inclusion, islands]),
    contrast=st.floats(-8, 8),
    contacts=st.lists(st.floats(-9, 9), min_size=8, max_size=8),
)
@_FEW
def test_any_contrast_with_any_contacts_is_right_or_refused(kind, contrast, contacts):
    model = small_model()
    impedance = 10 ** np.array(contacts) * model.prepared.contacts.lengths_mm
    made = None
    with suppress(ValueRangeError):
        made = model.with_values(conductance=kind(10**contrast), contact_impedance=impedance)
    if made is not None:
        event("accepted")
        check(compare_fifty_digits(made))


@pytest.mark.rest
@given(contrast=st.floats(-8, 0), ratio=st.floats(-8.9, 1), of_contacts=st.booleans())
@example(contrast=-2.0, ratio=0.5, of_contacts=False)  # the furthest apart that is not refined
@drawn(8)
def test_sensitivities_are_right_at_any_contrast_and_good_contact(contrast, ratio, of_contacts):
    with suppress(ValueRangeError):
        check(_sensitivities(islands(10**contrast), 10**ratio, of_contacts))


@pytest.mark.rest
@given(seed=st.integers(0, 2**32 - 1), decades=st.floats(0, 8))
@example(seed=55, decades=8.0)  # 2e-13, the worst of some hundred
@_FEW
def test_any_scatter_of_conductances_is_right(seed, decades):
    answer = compare_fifty_digits(small_model().with_values(conductance=scatter_conductance(decades, seed)))
    check(answer if decades <= 5 else replace(answer, bound=max(answer.bound, _SCATTERED)))


@pytest.mark.rest
@given(base=st.floats(-4, 4), log_factor=st.floats(-4, 4))
@_FEW
def test_any_load_on_any_sheet_is_right_by_local_update(base, log_factor):
    check(compare_load(islands(10**base), 10**log_factor))


@given(offset=st.floats(-3, 12))
@_FEW
def test_any_offset_costs_the_digits_it_takes_and_no_more(offset):
    check(_offset(10**offset))


@given(unit=st.floats(-30, 30))
@_FEW
def test_any_unit_of_voltages_gives_the_same_image(unit):
    check(_image_in_units(10**unit))


@given(offset=st.integers(0, 20), beginning=st.floats(0, 2e9))
@_FEW
def test_noise_is_the_same_on_any_level_at_any_time(offset, beginning):
    """Levels are powers of two: noise of whole multiples of 2⁻³⁰ is added to them without a rounding."""
    check(_noise(2.0**offset, beginning))


@given(frames=st.floats(-3, 14))
@drawn(6)
def test_frames_alike_for_any_time_are_right(frames):
    check(_lasting(10**frames))


def problem_of(seed: int, decades: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Jacobian with singular values over some decades, weights, variances, readings."""
    random = np.random.default_rng(seed)
    left, _ = linalg.qr(random.standard_normal((12, 12)))
    right, _ = linalg.qr(random.standard_normal((30, 12)), mode="economic")
    jacobian = (left * np.logspace(0, -decades, 12)) @ right.T
    return jacobian, random.uniform(0.5, 2.0, 30), random.uniform(0.3, 3.0, 12), random.standard_normal(12)


@given(seed=st.integers(0, 2**32 - 1), decades=st.floats(0, 9), relative=st.floats(-12, 6))
@drawn(40)
def test_any_regularisation_of_any_problem_is_right(seed, decades, relative):
    jacobian, weights, variance, readings = problem_of(seed, decades)
    sizes = linalg.svdvals(jacobian / np.sqrt(variance)[:, None] / np.sqrt(weights))
    value = 10**relative * float(sizes[0])
    exact = exact_image(jacobian, weights, value, variance, readings)
    bound = condition_bound(ridge_condition(sizes, value))
    for matrix in (
        dual_matrix(jacobian, weights, value, variance),
        dual_spectrum(jacobian, weights, variance).matrix(value),
    ):
        size = np.linalg.norm(matrix, 2) * np.linalg.norm(readings)
        assert np.linalg.norm(matrix @ readings - exact) <= bound * size


@given(seed=st.integers(0, 2**32 - 1), decades=st.floats(0, 8))
@_FEW
def test_no_regularisation_is_the_image_of_least_norm(seed, decades):
    jacobian, _, _, readings = problem_of(seed, decades)
    exact = exact_image(jacobian, np.ones(30), 0.0, np.ones(12), readings)
    sizes = linalg.svdvals(jacobian)
    found = dual_matrix(jacobian, np.ones(30), 0.0) @ readings
    assert np.linalg.norm(found - exact) <= condition_bound(sizes[0] / sizes[-1]) * np.linalg.norm(exact)


def test_truths_agree_where_nothing_is_hard():
    """The textbook form in fifty digits against the model that eliminates the electrodes, in doubles."""
    model = small_model()
    exact = exact_readings(model.mesh, model.pattern, model.conductance, model.contact_impedance)
    assert relative_error(model.voltages(), exact, model.pattern) < 1e-14
    driven = ~model.pattern.usable()
    assert np.allclose(model.voltages()[driven], exact[driven], rtol=1e-13)
    jacobian, weights, variance, readings = problem_of(3, 1.0)
    normal = jacobian.T @ (jacobian / variance[:, None]) + 0.04 * np.diag(weights)
    textbook = np.linalg.solve(normal, jacobian.T @ (readings / variance))
    assert np.allclose(exact_image(jacobian, weights, 0.2, variance, readings), textbook, rtol=1e-12)
