"""Registration of places: exact similarities, errors that are honest, and what says nothing."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.readings.loads import NINE_LOCATIONS_MM
from cbsr_qa.eit.imaging.registration import register

NINE = np.array(NINE_LOCATIONS_MM)


def moved(places, shift_mm, rotation_deg, scale):
    turn = np.radians(rotation_deg)
    matrix = scale * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    return places @ matrix.T + shift_mm


@given(shift=st.tuples(st.floats(-9, 9), st.floats(-9, 9)), rotation=st.floats(-170, 170), scale=st.floats(0.5, 1.6))
def test_a_similarity_is_found_exactly(shift, rotation, scale):
    found = register(NINE + 3.0, moved(NINE + 3.0, shift, rotation, scale))
    np.testing.assert_allclose(found.shift_mm, shift, rtol=0, atol=1e-10)
    assert found.rotation_deg == pytest.approx(rotation, abs=1e-9)
    assert found.scale == pytest.approx(scale, rel=1e-11)
    assert found.errors_mm.max() < 1e-10
    assert max(found.shift_stderr_mm, found.rotation_stderr_deg, found.scale_stderr) < 1e-9


def test_what_is_left_is_what_no_similarity_explains():
    """Alternating radial errors on the ring of four at 30 mm: no shift, turn or scale has any of it."""
    ring = 30.0 * np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])
    errors = np.array([[1.0, 0], [0, -1.0], [-1.0, 0], [0, 1.0]])
    found = register(ring, ring + errors)
    np.testing.assert_allclose(found.residuals_mm, errors, atol=1e-12)
    assert found.scale == pytest.approx(1.0)
    np.testing.assert_allclose(found.shift_mm, 0, atol=1e-12)


def test_standard_errors_are_those_of_the_scatter():
    draw, found = np.random.default_rng(4), []
    for _ in range(2000):
        one = register(NINE, moved(NINE, (0.4, -0.2), 1.5, 1.02) + 0.3 * draw.standard_normal(NINE.shape))
        found.append((one.shift_mm[0], one.rotation_deg, one.scale, one.shift_stderr_mm, one.rotation_stderr_deg,
                      one.scale_stderr))  # fmt: skip
    values = np.array(found)
    assert values[:, :3].mean(axis=0) == pytest.approx([0.4, 1.5, 1.02], abs=0.02)
    stated = np.sqrt((values[:, 3:] ** 2).mean(axis=0))
    assert stated / values[:, :3].std(axis=0) == pytest.approx(1.0, abs=0.06)


def test_an_origin_far_away_costs_only_the_digits_of_the_places():
    """At 1e6 mm places have 1e-10 mm: the similarity used to lose the square of that."""
    found = register(NINE + 1e6, moved(NINE, (0.0, 0.0), 12.0, 1.25) + 3e6)
    assert found.scale == pytest.approx(1.25, rel=1e-10)
    assert found.rotation_deg == pytest.approx(12.0, abs=1e-8)
    assert found.errors_mm.max() < 2e-9


def test_loads_that_all_lie_in_a_line_are_no_mirror_image():
    line = NINE[[0, 1, 2]]
    assert register(line, moved(line, (1.0, 2.0), 180.0, 0.9)).scale == pytest.approx(0.9)


@pytest.mark.parametrize("some", [NINE, NINE[:4], NINE + 7.0])
@pytest.mark.parametrize("mirror", [(1, -1), (-1, 1)])
def test_a_mirror_image_is_called_one(some, mirror):
    errors = 0.3 * np.random.default_rng(3).standard_normal(some.shape)
    with pytest.raises(NumericsError, match="mirror image"):
        register(some, moved(some * mirror, (0.5, -1.0), 20.0, 0.95) + errors)


@pytest.mark.parametrize(
    ("nominal", "seen", "said"),
    [
        (NINE[:2], NINE[:2], "2 places say nothing"),
        (np.zeros((4, 2)), NINE[:4], "pressed at one place"),
        (np.full((4, 2), 1e9 + 0.1), NINE[:4] + 1e9, "pressed at one place"),
        (NINE, np.ones((9, 2)), "seen at one place"),
        (NINE + 1e9, np.full((9, 2), 1e9 + 0.1), "seen at one place"),
        (
            np.array([[1, 0], [0, 1], [-1, 0], [0, -1.0]]),
            np.array([[1, 0], [-1, 0], [1, 0], [-1.0, 0]]),
            "no rotation",
        ),
        (NINE, np.full((9, 2), np.nan), "not finite"),
        (NINE, NINE[:5], "do not match"),
    ],
)
def test_what_says_nothing_is_refused(nominal, seen, said):
    with pytest.raises(NumericsError, match=said):
        register(nominal, seen)
