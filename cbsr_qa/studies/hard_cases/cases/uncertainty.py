"""Hard cases of budgets: a single degree of freedom, inputs of zero, correlations of one."""

from math import inf
from typing import Final

import mpmath

from cbsr_qa.calibration.uncertainty.combination import BudgetInput, combine
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.studies.hard_cases.case import Answer, Area, answer_from_condition
from cbsr_qa.studies.hard_cases.exact import DIGITS, relative_error

AREA: Final = Area("uncertainty")


def list_inputs(*rows: tuple[float, float, float]) -> list[BudgetInput]:
    """Return inputs of (uncertainty, sensitivity, degrees of freedom)."""
    return [BudgetInput(f"x{n}", "A", u, c, "a hard case", dof) for n, (u, c, dof) in enumerate(rows)]


@AREA.against("Cauchy's distribution in fifty digits")
def one_degree_of_freedom() -> Answer:
    """Two repeats alone: Student's t of one degree of freedom has no variance, and k is 12.7."""
    budget = combine(list_inputs((2.0, 1.5, 1.0)))
    with mpmath.workdps(DIGITS):
        exact = 3 * mpmath.tan(mpmath.pi * (mpmath.mpf(0.95) / 2))
    # k = tan(π p/2) turns a relative change of p into one 19 times as large
    return answer_from_condition(relative_error(budget.expanded, exact), 20.0, note=f"k = {budget.k:.6g}")


@AREA.against("the budget without it")
def input_of_zero() -> Answer:
    """An input of no uncertainty with one degree of freedom: zero to the fourth power over one."""
    rows = ((3.0, 1.0, 7.0), (4.0, 1.0, 9.0))
    budget, alone = combine(list_inputs(*rows, (0.0, 1.0, 1.0))), combine(list_inputs(*rows))
    return answer_from_condition(relative_error(budget.expanded, mpmath.mpf(alone.expanded)), 1.0)


@AREA.against("zero")
def all_inputs_of_zero() -> Answer:
    """Nothing is uncertain: degrees of freedom are zero over zero."""
    budget = combine(list_inputs((0.0, 1.0, 1.0), (0.0, 1.0, inf)))
    return Answer(budget.expanded, 0.0, note=f"k = {budget.k:.6g}")


@AREA.against("the sum of the inputs in fifty digits")
def inputs_correlated_by_one() -> Answer:
    """Two errors that are one, of sizes 10⁸ apart: they add, and squares would lose the smaller one."""
    rows = ((1.0, 1.0, inf), (1e-8, 1.0, inf))
    budget = combine(list_inputs(*rows), correlations={("x0", "x1"): 1.0})
    return answer_from_condition(relative_error(budget.standard_uncertainty, 1 + mpmath.mpf(1e-8)), 1.0)


@AREA.against("the difference of the inputs in fifty digits")
def inputs_correlated_by_minus_one() -> Answer:
    """Two errors that all but cancel: their squares agree in all digits but the last."""
    other = 1 + 1e-8
    budget = combine(list_inputs((1.0, 1.0, inf), (other, 1.0, inf)), correlations={("x0", "x1"): -1.0})
    with mpmath.workdps(DIGITS):
        exact = mpmath.mpf(other) - 1
    return answer_from_condition(relative_error(budget.standard_uncertainty, exact), 2e8)


@AREA.against("zero")
def inputs_that_cancel() -> Answer:
    """Equal errors of opposite effect: nothing is left, of a sum whose terms are one."""
    budget = combine(list_inputs((1.0, 1.0, 1.0), (1.0, -1.0, 4.0)), correlations={("x0", "x1"): 1.0})
    return Answer(budget.expanded, 0.0)


@AREA.refuses(NumericsError)
def correlations_that_contradict() -> None:
    """Three inputs, each pair correlated by −1: their variance would be negative."""
    pairs = {("x0", "x1"): -1.0, ("x1", "x2"): -1.0, ("x0", "x2"): -1.0}
    combine(list_inputs(*(3 * ((1.0, 1.0, inf),))), correlations=pairs)
