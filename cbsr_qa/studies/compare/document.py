"""A comparison as one JSON document; what does not exist is null."""

from typing import Any

from cbsr_qa.stats import Capability, Index, Interval, Yield
from cbsr_qa.studies.compare.comparison import Comparison
from cbsr_qa.studies.compare.describe import Described, Group
from cbsr_qa.studies.compare.differences import Difference
from cbsr_qa.studies.compare.metric import MetricComparison
from cbsr_qa.studies.compare.wording import alike, headline, rules, sentences


def document(found: Comparison) -> dict[str, Any]:
    """Return what ``compare --json`` prints."""
    terms = found.terms
    return {
        "by": str(terms.by),
        "reference": found.reference,
        "compared": found.compared,
        "policy": str(terms.policy),
        "quarantine": str(terms.quarantine),
        "adjustment": str(terms.adjustment),
        "confidence": terms.confidence,
        "recipes": list(found.recipes),
        "simulated": list(found.simulated),
        "headline": headline(found),
        "sentences": sentences(found),
        "rules": rules(found),
        "groups": [_group(group) for group in found.groups],
        "metrics": [_difference(metric, one, found) for metric in found.metrics for one in _or_none(metric)],
        "stations": [_station(metric, one) for metric in found.metrics for one in metric.stations],
        "distributions": [_described(metric, one) for metric in found.metrics for one in metric.described],
        "warnings": list(found.warnings),
    }


def _or_none(metric: MetricComparison) -> tuple[Difference | None, ...]:
    return metric.differences or (None,)


def _identity(metric: MetricComparison) -> dict[str, Any]:
    key = metric.figures.key
    return {"name": key.name, "phase": key.phase, "qualifier": key.qualifier, "unit": metric.figures.unit}


def _group(group: Group) -> dict[str, Any]:
    return {
        "name": group.name,
        "n": group.sensors,
        "runs": group.runs,
        "yield": None if group.passed is None else group.passed.value,
        "yield_interval": _yield_ends(group.passed),
        "first_pass_yield": None if group.first_pass is None else group.first_pass.value,
        "first_pass_yield_interval": _yield_ends(group.first_pass),
        "not_measured": group.unmeasured,
        "not_judged": group.unjudged,
        "stations": list(group.stations),
        "batches": list(group.batches),
        "failures": [{"metric": label, "sensors": count} for label, count in group.failures],
    }


def _yield_ends(found: Yield | None) -> list[float] | None:
    return None if found is None else [found.wilson.low, found.wilson.high]


def _difference(metric: MetricComparison, one: Difference | None, found: Comparison) -> dict[str, Any]:
    one = one or Difference("", "", "none")  # the same keys where a metric has no groups to compare
    return {
        **_identity(metric),
        "group": one.group or None,
        "reference": one.reference or None,
        **_estimate(one),
        "effect_size": one.effect,
        "effect_size_interval": _ends(one.effect_interval),
        **_equivalence(one, found),
        "deviation": one.deviation,
        "detect": one.detect,
        "sensors_needed": one.needed,
        "naive": _naive(one),
        "robust": _robust(one),
        "model": one.model,
        "places": [
            {
                "location": place.location,
                "x_mm": place.x_mm,
                "y_mm": place.y_mm,
                "difference": place.value,
                "low": place.low,
                "high": place.high,
                "p": place.p_adjusted,
            }
            for place in metric.maps.get(one.group, ())
        ],
        "warnings": [*one.warnings, *metric.notes],
    }


def _equivalence(one: Difference, found: Comparison) -> dict[str, Any]:
    test = one.equivalence
    return {
        "equivalent": None if test is None else alike(one, found),
        "margin": None if test is None else test.margin,
        "equivalence_interval": None if test is None else _ends(test.interval),
        "equivalence_p": one.equivalence_p,
        "equivalence_p_unadjusted": None if test is None else test.p_value,
        "sensors_to_show_alike": one.needed_alike,
    }


def _estimate(one: Difference) -> dict[str, Any]:
    return {
        "difference": one.value,
        "low": None if one.interval is None else one.interval.low,
        "high": None if one.interval is None else one.interval.high,
        "p": one.p_adjusted,
        "p_unadjusted": one.p_value,
    }


def _naive(one: Difference) -> dict[str, Any] | None:
    found = one.naive
    if found is None:
        return None
    ends = {"low": found.interval.low, "high": found.interval.high}
    return {"difference": found.difference, **ends, "p": found.p_value, "hedges_g": found.hedges_g}


def _robust(one: Difference) -> dict[str, Any] | None:
    found = one.robust
    if found is None:
        return None
    return {"shift": found.shift, "interval": _ends(found.interval), "p": found.p_value, "method": found.method}


def _station(metric: MetricComparison, one: Difference) -> dict[str, Any]:
    named = {"station": one.group, "reference": one.reference}
    return {**_identity(metric), **named, **_estimate(one), "warnings": list(one.warnings)}


def _described(metric: MetricComparison, one: Described) -> dict[str, Any]:
    median = one.median
    return {
        **_identity(metric),
        "group": one.group,
        "n": one.count,
        "mean": one.mean,
        "deviation": one.deviation,
        "median": None if median is None else median.value,
        "median_interval": None if median is None else _ends(median.interval),
        "quantiles": {f"{found.share:g}": found.value for found in one.quantiles},
        "capability": _capability(one.capability),
        "no_capability": one.no_capability or None,
    }


def _capability(found: Capability | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {name: _index(getattr(found, name)) for name in ("cp", "cpk", "pp", "ppk")}


def _index(index: Index | None) -> dict[str, Any] | None:
    if index is None:
        return None
    return {"value": index.value, "low": index.interval.low, "high": index.interval.high, "method": index.method}


def _ends(interval: Interval | None) -> list[float] | None:
    return None if interval is None else [interval.low, interval.high]
