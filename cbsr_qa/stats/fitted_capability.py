"""Capability by the percentiles of a fitted family (ISO 22514-4; the default of common quality software).

With the points x₀.₁₃₅, x₅₀ and x₉₉.₈₆₅ of the family that was fitted to all values,

    Pp = (U − L)/(x₉₉.₈₆₅ − x₀.₁₃₅),  Ppk = min((U − x₅₀)/(x₉₉.₈₆₅ − x₅₀), (x₅₀ − L)/(x₅₀ − x₀.₁₃₅)).

There is no Cp or Cpk: the scatter within subgroups has no percentiles that the trade agrees on. Intervals come from
samples of the fitted family (parametric bootstrap, seeded) by the pivots of :mod:`cbsr_qa.stats.fitted_families`. If
the family is chosen by AIC, samples come from all compared families, in proportion to their Akaike weights
exp(−ΔAIC/2) (Burnham & Anderson 2002, section 2.9). ``benchmarks/fitted_capability.py`` measures how often they hold.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated, Final

import numpy as np
from pydantic import Field, InstanceOf

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.stats.fitted_families import COMPARED, FAMILIES, FittedFamily, Threshold
from cbsr_qa.stats.percentile_capability import SHARES, pool_subgroups
from cbsr_qa.stats.process_capability import Index

#: Word that leaves the choice to AIC.
BEST: Final = "best"
_FEWEST_FOR_THRESHOLD: Final = 30
_DRAWS: Final = 2000
_TEST_DRAWS: Final = 500
_MOST_AT_ONCE: Final = 2_000_000  #: values drawn at once, for the memory
_MILLION: Final = 1e6
_OF_NAMED: Final = "parametric bootstrap by pivots, for values of this family"
_OF_CHOSEN: Final = "parametric bootstrap by pivots of the compared families, by Akaike weights"


@dataclass(frozen=True, slots=True)
class FamilyFit:
    """A family that was fitted.

    Parameters
    ----------
    parameters : by name; location and scale are those of log x for log-normal, Weibull and log-logistic values.
    anderson_darling : A²; smaller fits better.
    aic : Akaike's criterion; smaller fits better.
    """

    family: str
    parameters: dict[str, float]
    anderson_darling: float
    aic: float


@dataclass(frozen=True, slots=True)
class PartsPerMillion:
    """Expected nonconforming parts per million.

    Parameters
    ----------
    below, above : of each limit; None without that limit.
    total, low, high : of both, and its interval.
    """

    below: float | None
    above: float | None
    total: float
    low: float
    high: float


@dataclass(frozen=True, slots=True, eq=False)
class FittedCapability:
    """Capability of values of a fitted family.

    Parameters
    ----------
    chosen : ``"by hand"``, or ``"least AIC"`` of the families with two parameters.
    fit : the family.
    p_value : of Anderson and Darling's test of this family, with estimated parameters (bootstrap).
    compared : all families that the values can have, the least AIC first.
    percentiles : points of 0.135, 50 and 99.865 %, in the values' unit.
    pp : None with one limit.
    values : the fitted values, for the figure.
    """

    chosen: str
    fit: FamilyFit
    p_value: float
    compared: tuple[FamilyFit, ...]
    percentiles: tuple[float, float, float]
    pp: Index | None
    ppk: Index
    ppm: PartsPerMillion
    values: Annotated[InstanceOf[np.ndarray] | None, Field(exclude=True)] = None


@dataclass(frozen=True, slots=True, eq=False)
class _Indices:
    """Indices by parameters (k, draws).

    Parameters
    ----------
    rooms : (limits, draws) index of each limit.
    pp : (draws,); None with one limit.
    outside : (limits, draws) parts per million beyond each limit.
    """

    rooms: Array
    pp: Array | None
    outside: Array


def fitted_capability(
    groups: Sequence[Iterable[float]],
    family: str,
    *,
    lower: float | None,
    upper: float | None,
    confidence: float,
) -> FittedCapability:
    """Return Pp, Ppk and the nonconforming share of values in subgroups by a fitted family.

    Parameters
    ----------
    groups : values of each subgroup, in the unit of the limits.
    family : a name of :data:`~cbsr_qa.stats.fitted_families.FAMILIES`, or :data:`BEST`.
    lower, upper : limits; at least one.

    Raises
    ------
    NumericsError
        Too few or equal values, values that the family cannot have, or subgroups that differ.
    """
    values = pool_subgroups(groups)
    if isinstance(values, str):
        raise NumericsError(values)
    if family != BEST:
        _check_support(FAMILIES[family], values)
    fits = [_fit(each, values) for each in FAMILIES.values() if _is_possible(each, values)]
    candidates = [fit for fit in fits if family in (BEST, fit.family) and (family != BEST or _is_compared(fit))]
    best = min(candidates, key=lambda fit: fit.aic)
    weights = np.exp((best.aic - np.array([fit.aic for fit in candidates])) / 2)
    draws = np.rint(_DRAWS * weights / weights.sum()).astype(int)
    drawn = [
        _draw_indices(fit, count, len(values), lower, upper)
        for fit, count in zip(candidates, draws.tolist(), strict=True)
        if count
    ]
    estimate = _find_indices(FAMILIES[best.family], _parameters(best), lower, upper)
    pp, ppk = _summarise_indices(estimate, drawn, confidence, _OF_CHOSEN if family == BEST else _OF_NAMED)
    return FittedCapability(
        chosen="least AIC" if family == BEST else "by hand",
        fit=best,
        p_value=_test_family(best, len(values)),
        compared=tuple(sorted(fits, key=lambda fit: fit.aic)),
        percentiles=_find_percentiles(best),
        pp=pp,
        ppk=ppk,
        ppm=_summarise_outside(estimate, drawn, lower, upper, confidence),
        values=values,
    )


def _is_possible(family: FittedFamily, values: Array) -> bool:
    enough = not isinstance(family, Threshold) or len(values) >= _FEWEST_FOR_THRESHOLD
    return enough and (not family.positive or float(values.min()) > 0)


def _is_compared(fit: FamilyFit) -> bool:
    return FAMILIES[fit.family] in COMPARED


def _check_support(family: FittedFamily, values: Array) -> None:
    if family.positive and values.min() <= 0:
        raise NumericsError(
            f"{family.name} values are above 0; {np.sum(values <= 0)} of {len(values)} are not, the least is "
            f"{values.min():.6g}",
            remedy="choose a normal, logistic, extreme-value or 3-parameter distribution",
        )
    if not _is_possible(family, values):
        raise NumericsError(
            f"a {family.name} distribution needs {_FEWEST_FOR_THRESHOLD} values; there are {len(values)}",
            remedy="choose a distribution with two parameters",
        )


def _fit(family: FittedFamily, values: Array) -> FamilyFit:
    sample = values[None]
    parameters = family.fit(sample)
    named = dict(zip(family.parameter_names, (float(each[0]) for each in parameters), strict=True))
    statistic, aic = family.anderson_darling(parameters, sample), family.aic(parameters, sample)
    return FamilyFit(family.name, named, float(statistic[0]), float(aic[0]))


def _parameters(fit: FamilyFit) -> Array:
    return np.array(list(fit.parameters.values()))[:, None]


def _draw_samples(fit: FamilyFit, draws: int, count: int) -> Iterable[Array]:
    """Yield samples of the fitted family, (some, count) each."""
    random = np.random.default_rng(22514)
    for part in np.array_split(np.arange(draws), -(-draws * count // _MOST_AT_ONCE)):
        yield FAMILIES[fit.family].quantile(_parameters(fit), random.random((len(part), count)))


def _draw_indices(fit: FamilyFit, draws: int, count: int, lower: float | None, upper: float | None) -> _Indices:
    """Return the indices by parameters that may be the true ones."""
    family = FAMILIES[fit.family]
    drawn = np.concatenate([family.fit(samples) for samples in _draw_samples(fit, draws, count)], axis=1)
    return _find_indices(family, family.pivot(_parameters(fit), drawn), lower, upper)


def _test_family(fit: FamilyFit, count: int) -> float:
    """Return the share of samples of the family that fit it worse."""
    family, worse = FAMILIES[fit.family], 0
    for samples in _draw_samples(fit, _TEST_DRAWS, count):
        worse += int(np.sum(family.anderson_darling(family.fit(samples), samples) >= fit.anderson_darling))
    return (worse + 1) / (_TEST_DRAWS + 1)


def _find_percentiles(fit: FamilyFit) -> tuple[float, float, float]:
    least, middle, greatest = (float(FAMILIES[fit.family].quantile(_parameters(fit), share)[0]) for share in SHARES)
    return least, middle, greatest


def _find_indices(family: FittedFamily, parameters: Array, lower: float | None, upper: float | None) -> _Indices:
    least, middle, greatest = (family.quantile(parameters, share) for share in SHARES)
    rooms, outside = [], []
    if lower is not None:
        rooms.append((middle - lower) / (middle - least))
        outside.append(_MILLION * family.share_below(parameters, lower))
    if upper is not None:
        rooms.append((upper - middle) / (greatest - middle))
        outside.append(_MILLION * (1 - family.share_below(parameters, upper)))
    pp = None if lower is None or upper is None else (upper - lower) / (greatest - least)
    return _Indices(np.array(rooms), pp, np.array(outside))


def _summarise_indices(
    estimate: _Indices, drawn: Sequence[_Indices], confidence: float, method: str
) -> tuple[Index | None, Index]:
    """Return Pp and Ppk."""
    tails = (1 - confidence) / 2, (1 + confidence) / 2
    rooms = np.concatenate([each.rooms for each in drawn], axis=1)
    low = float(np.quantile(rooms.min(axis=0), tails[0]))
    # Where both rooms are alike, draws of the lesser one lie below it: the upper end is the lesser of the sides'.
    high = float(np.quantile(rooms, tails[1], axis=1).min())
    ppk = Index(float(estimate.rooms.min()), low, high, method)
    if estimate.pp is None:
        return None, ppk
    low, high = np.quantile(np.concatenate([each.pp for each in drawn if each.pp is not None]), tails)
    return Index(float(estimate.pp[0]), float(low), float(high), method), ppk


def _summarise_outside(
    estimate: _Indices, drawn: Sequence[_Indices], lower: float | None, upper: float | None, confidence: float
) -> PartsPerMillion:
    sides = [float(each[0]) for each in estimate.outside]
    totals = np.concatenate([each.outside.sum(axis=0) for each in drawn])
    low, high = np.quantile(totals, ((1 - confidence) / 2, (1 + confidence) / 2))
    below = None if lower is None else sides[0]
    return PartsPerMillion(below, None if upper is None else sides[-1], sum(sides), float(low), float(high))
