"""Budgets: the printed example of the GUM, Welch and Satterthwaite, correlated inputs, and inputs that cannot be."""

from dataclasses import replace
from math import inf, sqrt

import pytest

from cbsr_qa.calibration.uncertainty.combination import BudgetInput, combine, coverage_factor
from cbsr_qa.domain.errors import NumericsError


def listed(name, uncertainty, sensitivity=1.0, dof=inf):
    return BudgetInput(name, "A", uncertainty, sensitivity, "a test", dof)


#: JCGM 100, table H.1: length of the standard and expansion; u(x) in the digits that are printed.
_LENGTH_NM, _EXPANSION, _TEMPERATURE_C = 50.000_623e6, 11.5e-6, -0.1
_PRINTED = [
    listed("standard", 25.0, dof=18),
    listed("difference", 9.7, dof=25.6),
    listed("difference of expansions", 0.58e-6, -_LENGTH_NM * _TEMPERATURE_C, dof=50),
    listed("difference of temperatures", 0.029, -_LENGTH_NM * _EXPANSION, dof=2),
    listed("expansion of the standard", 1.2e-6, 0.0),
    listed("temperature of the bed", 0.41, 0.0),
]


def test_the_difference_of_the_end_gauges_of_the_gum_has_its_printed_digits():
    """JCGM 100, H.1.3.2, of values in the digits that are printed [nm]."""
    budget = combine(
        [listed("repeated", 5.8, dof=24), listed("random", 3.9, dof=5), listed("systematic", 6.7, dof=8)]
    )
    assert f"{budget.standard_uncertainty:.1f}" == "9.7"
    # printed as 25.6, from 9.7 nm instead of 9.68
    assert f"{budget.dof * (9.7 / budget.standard_uncertainty) ** 4:.1f}" == "25.6"


def test_the_end_gauge_of_the_gum_has_its_printed_budget():
    budget = combine(_PRINTED, coverage=0.99)
    assert f"{(_LENGTH_NM + 215) / 1e6:.6f}" == "50.000838"
    assert f"{budget.standard_uncertainty:.0f}" == "32"
    assert f"{budget.dof:.1f}" == "16.7"
    assert f"{budget.k:.2f}" == "2.92"
    assert f"{budget.expanded:.0f}" == "93"
    assert sum(part.share for part in budget.components) == pytest.approx(1)


def test_the_contributions_of_the_end_gauge_are_the_printed_ones():
    """The printed contributions are those of 0.05/√3 °C and 1e-6/√3, not of their printed digits."""
    exact = {"difference of expansions": 1e-6 / sqrt(3), "difference of temperatures": 0.05 / sqrt(3)}
    budget = combine([replace(item, uncertainty=exact.get(item.name, item.uncertainty)) for item in _PRINTED])
    parts = [(part.name, f"{part.standard_uncertainty:.1f}") for part in budget.components]
    assert parts == [
        ("standard", "25.0"),
        ("difference of temperatures", "16.6"),
        ("difference", "9.7"),
        ("difference of expansions", "2.9"),
        ("expansion of the standard", "0.0"),
        ("temperature of the bed", "0.0"),
    ]


@pytest.mark.parametrize(("dof", "k"), [(1, "12.71"), (2, "4.30"), (16.76, "2.12"), (50, "2.01"), (inf, "1.96")])
def test_coverage_factors_are_those_of_table_g2_with_truncated_degrees_of_freedom(dof, k):
    assert f"{coverage_factor(dof):.2f}" == k


def test_one_degree_of_freedom_alone_expands_by_students_t_of_one():
    budget = combine([listed("single", 2.0, dof=1), listed("nothing", 0.0)])
    assert budget.dof == 1
    assert budget.expanded == pytest.approx(2 * 12.7062047)


def test_an_input_of_zero_changes_nothing_and_stays_in_the_list():
    with_nothing = combine([listed("one", 3.0, dof=7), listed("zero", 0.0, dof=1)])
    alone = combine([listed("one", 3.0, dof=7)])
    assert (with_nothing.standard_uncertainty, with_nothing.dof) == (alone.standard_uncertainty, alone.dof)
    assert [(part.name, part.share) for part in with_nothing.components] == [("one", 1.0), ("zero", 0.0)]
    assert combine([listed("zero", 0.0, dof=1)]).expanded == 0


@pytest.mark.parametrize(("correlation", "expected"), [(1.0, 7.0), (-1.0, 1.0), (0.0, 5.0)])
def test_correlated_inputs_add_by_their_correlation(correlation, expected):
    inputs = [listed("one", 3.0), listed("other", 2.0, 2.0)]
    budget = combine(inputs, correlations={("one", "other"): correlation})
    assert budget.standard_uncertainty == pytest.approx(expected)
    assert sum(part.share for part in budget.components) == pytest.approx(1)


def test_inputs_that_cancel_leave_no_uncertainty():
    budget = combine([listed("one", 3.0, dof=1), listed("other", 3.0, -1.0)], correlations={("one", "other"): 1.0})
    assert (budget.standard_uncertainty, budget.expanded) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("inputs", "correlations", "said"),
    [
        ([listed("one", -1.0)], {}, "the uncertainty of one is -1.0"),
        ([listed("one", float("nan"))], {}, "the uncertainty of one is nan"),
        ([listed("one", 1.0, dof=0.5)], {}, "one has 0.5 degrees of freedom"),
        ([listed("one", 1.0), listed("one", 2.0)], {}, "two inputs of a budget have one name"),
        ([listed("one", 1.0), listed("two", 2.0)], {("one", "two"): 1.1}, "one and two cannot be correlated by 1.1"),
        ([listed("one", 1.0)], {("one", "three"): 0.5}, "one and three cannot be correlated by 0.5"),
    ],
)
def test_inputs_that_cannot_be_are_named(inputs, correlations, said):
    with pytest.raises(NumericsError) as caught:
        combine(inputs, correlations=correlations)
    assert said in caught.value.reason


def test_correlations_that_cannot_be_true_together_are_refused():
    inputs = [listed(name, 1.0) for name in ("one", "two", "three")]
    with pytest.raises(NumericsError, match="negative variance"):
        combine(inputs, correlations={("one", "two"): 1.0, ("two", "three"): 1.0, ("one", "three"): -1.0})
    budget = combine(inputs, correlations={("one", "two"): 1.0, ("two", "three"): 1.0, ("one", "three"): 1.0})
    assert budget.standard_uncertainty == pytest.approx(3)
