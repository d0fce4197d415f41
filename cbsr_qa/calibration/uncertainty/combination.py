"""Combines inputs to a budget: law of propagation, effective degrees of freedom, coverage factor. GTC computes.

GTC is imported where it is used: a run that states no expanded uncertainty does without it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import floor, inf, isfinite, isnan, sqrt
from typing import Final

import numpy as np

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.results.expanded_force import Budget, BudgetComponent

#: Coverage probability of expanded uncertainties.
COVERAGE: Final = 0.95
#: Pivot of a correlation matrix below which it is singular.
_SINGULAR: Final = 1e-12


@dataclass(frozen=True, slots=True)
class BudgetInput:
    """One input quantity of a result.

    Parameters
    ----------
    name, kind, source, shared : fields of :class:`~cbsr_qa.domain.results.expanded_force.BudgetComponent`.
    uncertainty : standard uncertainty u(x).
    sensitivity : c, the result's derivative by x.
    dof : degrees of freedom of u(x).
    """

    name: str
    kind: str
    uncertainty: float
    sensitivity: float
    source: str
    dof: float = inf
    shared: bool = False

    @property
    def contribution(self) -> float:
        """C u(x), in the result's unit."""
        return self.sensitivity * self.uncertainty


def combine(
    inputs: Sequence[BudgetInput],
    *,
    not_stated: Sequence[str] = (),
    correlations: Mapping[tuple[str, str], float] | None = None,
    coverage: float = COVERAGE,
) -> Budget:
    """Combine inputs (JCGM 100, 5.1.2, 5.2.2 and G.4.1).

    Parameters
    ----------
    correlations : correlation coefficients of pairs of inputs, by name; others are independent. The degrees of
        freedom of correlated inputs do not enter Welch and Satterthwaite's formula as such: all of them count as one
        input with the fewest.
    coverage : probability of the expanded uncertainty.

    Raises
    ------
    NumericsError
        If an uncertainty is negative or not finite, degrees of freedom are not positive, two inputs have one name, or
        correlations are none: outside −1 to 1, of unknown inputs, or of a negative variance.
    """
    correlated = dict(correlations or {})
    _check_inputs(inputs, correlated)
    variance, dof = _propagate(inputs, correlated)
    standard_uncertainty = variance**0.5
    shares = _share_variance(inputs, correlated, variance)
    components = [
        BudgetComponent(item.name, item.kind, item.contribution, item.dof, share, item.source, item.shared)
        for item, share in zip(inputs, shares, strict=True)
    ]
    components.sort(key=lambda component: -component.standard_uncertainty)
    return Budget(standard_uncertainty, dof, coverage_factor(dof, coverage), tuple(components), tuple(not_stated))


def coverage_factor(dof: float, coverage: float = COVERAGE) -> float:
    """Return Student's t of degrees of freedom, which are truncated to a whole number (JCGM 100, G.4.1)."""
    from GTC import reporting

    return float(reporting.k_factor(float(floor(dof)) if isfinite(dof) else inf, 100 * coverage))


def _check_inputs(inputs: Sequence[BudgetInput], correlations: Mapping[tuple[str, str], float]) -> None:
    names = [item.name for item in inputs]
    if len(set(names)) < len(names):
        raise NumericsError("two inputs of a budget have one name", remedy="name each")
    for item in inputs:
        if not (isfinite(item.contribution) and item.uncertainty >= 0):
            finding = f"the uncertainty of {item.name} is {item.uncertainty}, times {item.sensitivity}"
            raise NumericsError(finding, remedy="give a number of at least 0, and a finite sensitivity")
        if not item.dof >= 1:
            finding = f"{item.name} has {item.dof} degrees of freedom; at least 1 is needed"
            raise NumericsError(finding, remedy="repeat the measurement")
    for pair, coefficient in correlations.items():
        if not (set(pair) <= set(names) and pair[0] != pair[1] and -1 <= coefficient <= 1):
            finding = f"{' and '.join(pair)} cannot be correlated by {coefficient}"
            raise NumericsError(finding, remedy="correlate two inputs of the budget by −1 to 1")


def _propagate(inputs: Sequence[BudgetInput], correlations: Mapping[tuple[str, str], float]) -> tuple[float, float]:
    """Return variance and effective degrees of freedom of a result."""
    from GTC import dof, result, ureal, variance

    together = [item for item in inputs if any(item.name in pair for pair in correlations)]
    alone = [item for item in inputs if item not in together and item.contribution]
    parts = [item.sensitivity * ureal(0.0, item.uncertainty, item.dof) for item in alone]
    joint = _joint_variance(together, correlations)
    if joint > 0:
        parts.append(ureal(0.0, joint**0.5, min(item.dof for item in together)))
    if not parts:
        return 0.0, inf
    combined = result(sum(parts))
    degrees = float(dof(combined))
    return float(variance(combined)), inf if isnan(degrees) else degrees


def _joint_variance(inputs: Sequence[BudgetInput], correlations: Mapping[tuple[str, str], float]) -> float:
    """Return the variance cᵀ R c of the sum of correlated inputs (JCGM 100, 5.2.2), as ‖Lᵀ c‖² with R = L Lᵀ.

    With r = −1 that is (c₁ − c₂)², which keeps the digits of what does not cancel.
    """
    number = {item.name: index for index, item in enumerate(inputs)}
    matrix = np.eye(len(inputs))
    for (one, other), coefficient in correlations.items():
        matrix[number[one], number[other]] = matrix[number[other], number[one]] = coefficient
    parts = _factor(matrix).T @ np.array([item.contribution for item in inputs])
    return float(parts @ parts)


def _factor(matrix: Array) -> Array:
    """Return lower triangular L with L Lᵀ = a correlation matrix, which may be singular."""
    rest, factor = matrix.copy(), np.zeros_like(matrix)
    for column in range(len(matrix)):
        pivot = rest[column, column]
        if pivot > _SINGULAR:
            factor[:, column] = rest[:, column] / sqrt(pivot)
            rest -= np.outer(factor[:, column], factor[:, column])
        elif pivot < -_SINGULAR or np.abs(rest[:, column]).max() > sqrt(_SINGULAR):
            raise NumericsError(
                "the correlations of a budget's inputs give a negative variance",
                remedy="give correlations that can be true together",
            )
    return factor


def _share_variance(
    inputs: Sequence[BudgetInput], correlations: Mapping[tuple[str, str], float], variance: float
) -> list[float]:
    """Return shares of the variance, with half of each covariance; they may be negative. 0 of no variance."""
    contribution = {item.name: item.contribution for item in inputs}
    part = {name: value**2 for name, value in contribution.items()}
    for (one, other), r in correlations.items():
        for name in (one, other):
            part[name] += r * contribution[one] * contribution[other]
    return [part[item.name] / variance if variance > 0 else 0.0 for item in inputs]
