"""Drive and measure patterns: what each reading says, what the others say already, and what is refused."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.sensor.patterns import DrivePattern, adjacent_pattern, imaging_problems, list_pairs


def pairs_on(count):
    return st.tuples(st.integers(0, count - 1), st.integers(0, count - 1)).filter(lambda pair: pair[0] != pair[1])


@st.composite
def patterns(draw):
    count = draw(st.integers(3, 9))
    drive, measure = (tuple(draw(st.lists(pairs_on(count), min_size=1, max_size=14, unique=True))) for _ in range(2))
    return DrivePattern(count, drive, measure)


def any_transfer_impedance(count, seed=0):
    """Of some sheet: symmetric, positive definite on currents that sum to zero."""
    root = np.random.default_rng(seed).standard_normal((count, count))
    impedance = root @ root.T
    impedance -= impedance.mean(axis=0)
    return impedance - impedance.mean(axis=1, keepdims=True)


def readings_of(pattern, impedance):
    return pattern.drive_currents().T @ impedance @ pattern.measure_matrix()


def rank_by_definition(pattern, used):
    drive, measure = pattern.drive_currents(), pattern.measure_matrix()
    products = [np.outer(drive[:, d], measure[:, m]) for d, m in np.argwhere(used)]
    return np.linalg.matrix_rank(np.array([(p + p.T).ravel() for p in products])) if products else 0


@given(patterns())
def test_readings_of_one_group_are_equal_on_every_sheet_and_of_others_are_not(pattern):
    group, sign = pattern.reading_groups()
    readings = readings_of(pattern, any_transfer_impedance(pattern.electrode_count))
    said = (readings * sign).ravel()
    for one in np.unique(group):
        np.testing.assert_allclose(said[group.ravel() == one], said[group.ravel() == one][0], rtol=0, atol=1e-12)
    firsts = said[np.unique(group, return_index=True)[1]]
    assert len(np.unique(np.abs(firsts).round(9))) == len(firsts)


@given(patterns())
def test_reciprocal_pairs_tie_every_group_together_by_its_first_reading(pattern):
    group, _ = pattern.reading_groups()
    pairs, sign = pattern.reciprocal_pairs()
    readings = readings_of(pattern, any_transfer_impedance(pattern.electrode_count, 1)).ravel()
    np.testing.assert_allclose(readings[pairs[:, 0]], sign * readings[pairs[:, 1]], rtol=0, atol=1e-12)
    assert len(pairs) == group.size - group.max() - 1
    assert (pairs[:, 0] < pairs[:, 1]).all()
    assert len(np.unique(pairs[:, 1])) == len(pairs)


@pytest.mark.rest
@given(patterns(), st.randoms(use_true_random=False))
def test_the_independent_readings_are_the_rank_of_what_they_say(pattern, random):
    used = np.array([[random.random() < 0.7 for _ in pattern.measure] for _ in pattern.drive])
    assert pattern.independent_readings(used) == rank_by_definition(pattern, used)
    assert pattern.independent_readings() == rank_by_definition(pattern, pattern.usable())


@given(patterns())
def test_usable_readings_touch_no_driven_electrode(pattern):
    touched = np.array([[bool(set(d) & set(m)) for m in pattern.measure] for d in pattern.drive])
    np.testing.assert_array_equal(pattern.usable(), ~touched)


@pytest.mark.parametrize("count", [5, 8, 16, 21, 32])
def test_adjacent_pairs_have_as_many_independent_readings_as_the_field_counts(count):
    pattern = adjacent_pattern(count)
    assert pattern.usable().sum() == count * (count - 3)
    assert pattern.independent_readings() == count * (count - 3) // 2  # Adler & Holder 2021


@pytest.mark.parametrize("rules", [("adjacent", "skip-2"), ("opposite", "adjacent"), ("skip-4", "skip-3")])
def test_patterns_of_rules_are_counted_like_any_other(rules):
    pattern = DrivePattern(12, *(list_pairs(rule, 12) for rule in rules))
    assert pattern.independent_readings() == rank_by_definition(pattern, pattern.usable())


def test_no_pattern_has_more_independent_readings_than_the_sheet_has_numbers():
    every = tuple((i, j) for i in range(7) for j in range(7) if i != j)
    pattern = DrivePattern(7, every, every)
    assert pattern.independent_readings(np.ones(pattern.shape, dtype=bool)) == 7 * 6 // 2


def test_rules_name_the_pairs_they_promise():
    assert list_pairs("adjacent", 4) == ((0, 1), (1, 2), (2, 3), (3, 0))
    assert list_pairs("skip-1", 5) == ((0, 2), (1, 3), (2, 4), (3, 0), (4, 1))
    assert list_pairs("opposite", 6) == ((0, 3), (1, 4), (2, 5))


@pytest.mark.parametrize(
    ("rule", "count", "reason", "remedy"),
    [
        ("opposite", 9, "no two of", "use 'skip-3'"),
        ("skip-7", 16, "half of 16 electrodes or more", "use 'skip-6' or less, or 'opposite'"),
        ("skip-4", 9, "half of 9", "use 'skip-3' or less"),
        ("opposit", 16, "unknown pattern 'opposit'", "'skip-1', 'skip-2'"),
        ("skip--1", 16, "unknown pattern", "'adjacent'"),
    ],
)
def test_a_rule_that_does_not_suit_is_refused_with_one_that_does(rule, count, reason, remedy):
    with pytest.raises(RefusedError) as caught:
        list_pairs(rule, count)
    assert reason in caught.value.reason
    assert remedy in caught.value.remedy


@pytest.mark.parametrize(
    ("drive", "said"),
    [
        (((2, 2),), "pairs electrode 2 with itself"),
        (((0, 4),), "names electrode 4; allowed: 0 to 3"),
        (((-1, 0),), "names electrode -1"),
        (((0, 1.0),), "names electrode 1.0; electrodes have whole numbers"),
        ((("0", "1"),), "names electrode '0'; electrodes have whole numbers"),
        (((0, 1, 2),), "has 3 electrodes instead of two"),
        ((), "has no pairs"),
    ],
)
@pytest.mark.parametrize("kind", ["drive", "measure"])
def test_pairs_that_cannot_be_are_refused_by_name(drive, said, kind):
    given_pairs = (drive, ((0, 1),)) if kind == "drive" else (((0, 1),), drive)
    with pytest.raises(RefusedError) as caught:
        DrivePattern(4, *given_pairs)
    assert said.replace("drive", kind) in str(caught.value)


def test_a_reversed_pair_is_a_reading_that_adds_no_independent_one():
    plain = DrivePattern(8, list_pairs("adjacent", 8), list_pairs("adjacent", 8))
    both_ways = DrivePattern(8, plain.drive + tuple((b, a) for a, b in plain.drive), plain.measure)
    assert both_ways.usable().sum() == 2 * plain.usable().sum()
    assert both_ways.independent_readings() == plain.independent_readings()


def test_what_cannot_be_imaged_is_said():
    (few,) = imaging_problems(adjacent_pattern(5))
    assert "5 independent readings (10 touch no driven electrode); at least 8" in few
    idle, few = imaging_problems(DrivePattern(9, ((0, 1), (1, 2)), ((3, 4), (4, 5))))
    assert "never uses electrodes 6, 7, 8" in idle
    assert "4 independent readings" in few
    assert list(imaging_problems(adjacent_pattern(6))) == []
