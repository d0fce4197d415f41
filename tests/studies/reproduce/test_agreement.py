"""The rules by which our numbers agree with printed ones, at and around their bounds."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from cbsr_qa.studies.reproduce.compare import (
    Ours,
    Printed,
    PrintedRange,
    Rule,
    ValueOrigin,
    compare_value,
    deviations_agree,
    make_table,
    mean_of_deviations,
    show_beside,
    within_digits,
)

_RANGES = Printed(ranges=(PrintedRange("abstract", 22.5, 36.0), PrintedRange("4.3.2", 29.0, 41.0)))


def _row(rule, printed, ours, **options):
    return compare_value("8 wt%", "x", "1", ValueOrigin.OUTCOME, rule, printed, [ours], why="because", **options)


@pytest.mark.parametrize(("value", "agrees"), [(18.1, True), (8.3, True), (27.9, True), (8.2, False), (28.0, False)])
def test_one_printed_deviation_is_inclusive_on_both_sides(value, agrees):
    row = _row(Rule.DEVIATION, Printed(18.1, 9.8 + 1e-12), Ours("uniform", value))
    assert row.agrees is agrees
    assert row.reason == ("" if agrees else "because")


@settings(deadline=None)
@given(st.floats(-1e3, 1e3), st.floats(0, 1e3), st.floats(0, 1e3))
def test_a_number_without_deviation_may_be_rounded_and_ours_may_be_two_deviations_off(printed, half, spread):
    allowed = half + 2 * spread
    assert within_digits(printed + 0.99 * allowed, printed, half, spread * (1 + 1e-9) + 1e-9)
    assert not within_digits(printed + 1.01 * allowed + 1e-6, printed, half, spread)


@pytest.mark.parametrize(
    ("value", "uncertainty", "at_least", "agrees", "reason"),
    [
        (30.0, 0.0, False, True, ""),
        (22.5, 0.0, False, True, "inside the range of abstract only"),
        (40.0, 0.0, False, True, "inside the range of 4.3.2 only"),
        (41.1, 0.0, False, False, "because"),
        (42.0, 1.0, False, True, "inside the range of 4.3.2 only"),
        (30.0, 0.0, True, None, "a lower bound: not all loads had settled"),
        (41.5, 0.0, True, False, "because"),
    ],
)
def test_a_mean_agrees_inside_either_of_two_contradicting_ranges(value, uncertainty, at_least, agrees, reason):
    row = _row(Rule.RANGE, _RANGES, Ours("uniform", value, uncertainty, at_least=at_least))
    assert (row.agrees, row.reason) == (agrees, reason)


@pytest.mark.parametrize(("ours", "agrees"), [(50.0, True), (69.9, True), (70.0, False), (49.9, False)])
def test_bands_are_those_of_the_paper(ours, agrees):
    row = _row(Rule.BAND, Printed(69.6, 19.8), Ours("uniform", ours))
    assert row.agrees is agrees
    assert row.paper.band == "ok"


def test_two_deviations_of_normal_values_agree_as_often_as_two_standard_errors_say():
    """Deviations of equal spread are within two standard errors of their difference in about 95 % of trials."""
    generator = np.random.default_rng(5)
    draws = generator.standard_normal((4000, 2, 18)).std(axis=2, ddof=1)
    share = np.mean([deviations_agree(a, 18, b, 18) for a, b in draws])
    assert 0.93 < share < 0.97
    assert not deviations_agree(0.06, 18, 0.78, 18)
    of = mean_of_deviations("uniform", np.array([1.0, -1.0, 1.0, -1.0]))
    assert of.value == pytest.approx(np.sqrt(4 / 3))
    assert of.uncertainty == pytest.approx(np.sqrt(4 / 3) / np.sqrt(6))


def test_what_was_not_measured_or_means_something_else_neither_agrees_nor_differs():
    missing = _row(Rule.DEVIATION, Printed(1.0, 0.1), Ours("uniform", None, uncertainty_is="no blob was seen"))
    other = show_beside("8 wt%", "σ_n", "1", Printed(0.69), Ours("uniform", 1e-3), "a misprint")
    assert missing.agrees is other.agrees is None
    assert missing.reason == "not measured: no blob was seen"
    good, bad = (_row(Rule.DEVIATION, Printed(1.0, 0.1), Ours("uniform", value)) for value in (1.05, 1.2))
    table = make_table("t", (), (missing, other, good, bad))
    assert (table.agreeing, table.compared) == (1, 2)
