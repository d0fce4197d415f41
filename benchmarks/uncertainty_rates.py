"""Shares of told forces, errors and places that a stated U holds, and of loads that conform as stated."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from scipy.stats import t as student_t

from cbsr_qa.calibration.uncertainty.combination import BudgetInput, combine
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.results.expanded_force import GAIN_DRIFT, ExpandedForce
from cbsr_qa.stats.conformity import conformance_probability

_MAP: Final = "response of the sheet"
#: Ends of the bins of stated probabilities of conformance.
_BINS: Final = (0.0, 0.05, 0.2, 0.4, 0.6, 0.8, 0.95, 1.0)


@dataclass(frozen=True)
class Told:
    """What one sensor told of its loads, and the truth.

    Parameters
    ----------
    expanded : uncertainty of each force in use at the stated place.
    error_N : (n,) told in use less true forces.
    day_error_N : (n,) the same on the day of calibration.
    shown : uncertainty of the error that each press showed on that day.
    shown_error_N, own_error_N : (n,) that error, and the sensor's own.
    maximum_N : (n,) maximum permissible errors, which know nothing of this sensor.
    place_error_mm, place_U_mm : (n,) distances of told from true places, and stated radii.
    map_correlation : (n, n) correlation of the map's errors at the places of the loads.
    """

    expanded: tuple[ExpandedForce, ...]
    error_N: Array
    day_error_N: Array
    shown: tuple[ExpandedForce, ...]
    shown_error_N: Array
    own_error_N: Array
    maximum_N: Array
    place_error_mm: Array
    place_U_mm: Array
    map_correlation: Array


def hold_rates(told: Sequence[Told]) -> dict[str, tuple[float, float]]:
    """Share of forces, errors and places that U holds, with standard errors by sensors."""
    rates = {"in use": [float(np.mean(np.abs(one.error_N) <= [e.U_N for e in one.expanded])) for one in told]}
    rates["on the day"] = [
        float(np.mean(np.abs(one.day_error_N) <= [_expand_day(e) for e in one.expanded])) for one in told
    ]
    rates["error"] = [
        float(np.mean(np.abs(one.shown_error_N - one.own_error_N) <= [e.U_N for e in one.shown])) for one in told
    ]
    rates["place"] = [float(np.mean(one.place_error_mm <= one.place_U_mm)) for one in told]
    return {what: (float(np.mean(by)), float(np.std(by, ddof=1) / np.sqrt(len(by)))) for what, by in rates.items()}


def _expand_day(in_use: ExpandedForce) -> float:
    """Return U on the day of calibration, from the inputs of that in use [N]."""
    inputs = [
        BudgetInput(part.name, part.kind, abs(part.contribution), 1.0, part.source, part.dof)
        for part in in_use.components
        if part.name not in (GAIN_DRIFT, "temperature")
    ]
    return combine(inputs).expanded


def _state_conformance(told: Told) -> list[float]:
    loads = zip(told.shown_error_N.tolist(), told.maximum_N.tolist(), told.shown, strict=True)
    return [
        conformance_probability(error_N, maximum_N, shown.standard_uncertainty_N, shown.dof)
        for error_N, maximum_N, shown in loads
    ]


def compare_conformance(told: Sequence[Told]) -> list[tuple[float, float, float, int]]:
    """Return the mean stated probability of conformance by bins, the share that conforms, its standard error, loads.

    A load conforms if the sensor's own error is within the maximum. Sensors are independent, their loads are not.
    """
    stated = np.array([_state_conformance(one) for one in told])
    conforms = np.array([np.abs(one.own_error_N) <= one.maximum_N for one in told])
    bins = []
    for low, high in pairwise(_BINS):
        among = (stated >= low) & (stated < high if high < 1 else stated <= high)
        count = int(among.sum())
        if not count:
            continue
        share = float(conforms[among].mean())
        by_sensor = ((conforms - share) * among).sum(axis=1)
        bins.append((float(stated[among].mean()), share, float(np.sqrt((by_sensor**2).sum()) / count), count))
    return bins


def normalised_variance(told: Sequence[Told], without: str | None = None) -> tuple[float, float]:
    """Mean of eᵀ C⁻¹ e over the loads, C the stated covariance of a sensor's errors e, without a component.

    Returns
    -------
    The mean, 1 if the budget is right, and p of a mean of at most 1. Sensors are independent, their loads are not:
    each sensor is one value of a t-test.
    """
    by_sensor = np.array([_normalise(one, without) for one in told])
    mean, stderr = float(by_sensor.mean()), float(by_sensor.std(ddof=1) / np.sqrt(len(by_sensor)))
    return mean, float(student_t.sf((mean - 1) / stderr, len(by_sensor) - 1))


def _normalise(told: Told, without: str | None) -> float:
    covariance = np.zeros((len(told.error_N), len(told.error_N)))
    for name, dof, is_shared in {(part.name, part.dof, part.shared) for part in told.expanded[0].components}:
        if name == without:
            continue
        by_load = [{part.name: part.contribution for part in expanded.components} for expanded in told.expanded]
        contribution = np.array([contributions[name] for contributions in by_load])
        # an estimate of few degrees of freedom has errors that are distributed as t, whose variance is larger
        contribution = contribution * (1.0 if np.isinf(dof) else np.sqrt(dof / (dof - 2)))
        correlation = np.ones_like(covariance) if is_shared else np.eye(len(covariance))
        correlation = told.map_correlation if name == _MAP else correlation
        covariance += np.outer(contribution, contribution) * correlation
    return float(told.error_N @ np.linalg.solve(covariance, told.error_N)) / len(told.error_N)


def mean_shares(told: Sequence[Told]) -> dict[str, float]:
    """Mean share of the variance of each component, over all loads."""
    names = [part.name for part in told[0].expanded[0].components]
    shares = [{part.name: part.share for part in expanded.components} for one in told for expanded in one.expanded]
    return {name: float(np.mean([share[name] for share in shares])) for name in names}
