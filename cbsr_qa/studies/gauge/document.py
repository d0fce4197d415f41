"""A gauge study as one JSON document."""

from typing import TYPE_CHECKING, Any

from cbsr_qa.stats import Contrast, Interval, Referenced
from cbsr_qa.stats.gauge import GaugeAnova, Linearity, Variance, Variation
from cbsr_qa.studies.gauge.references import AgainstReferences
from cbsr_qa.studies.gauge.request import StudySource
from cbsr_qa.studies.gauge.words import source_of_variation

if TYPE_CHECKING:
    from cbsr_qa.studies.gauge.study import Gauge, MetricGauge

_PARTS = ("repeatability", "reproducibility", "gauge", "sensor", "total")


def gauge_document(found: "Gauge") -> dict[str, Any]:
    """Return everything for ``--json``."""
    request = found.request
    return {
        "study": _study(request.source),
        "appraiser": request.appraiser,
        "confidence": request.confidence,
        "since": None if request.since is None else str(request.since),
        "until": None if request.until is None else str(request.until),
        "by_location": request.by_location,
        "largest_balanced": request.largest_balanced,
        "recipe": found.runs[0].recipe,
        "sensors": list(found.sensors()),
        "stations": sorted({line.station for line in found.runs}),
        "appraisers": list(found.appraisers()),
        "runs": [line.run for line in found.runs],
        "simulated": found.simulated,
        "notes": list(found.notes),
        "metrics": [_metric(one, request.confidence) for one in found.metrics],
    }


def _study(source: StudySource | None) -> dict[str, str] | None:
    return None if source is None else {"name": source.name, "file": source.file, "sha256": source.sha256}


def interval_document(interval: Interval | None) -> list[float | None] | None:
    """Return both ends, None where one is open; None where there is no interval."""
    if interval is None:
        return None
    return [end if abs(end) < float("inf") else None for end in (interval.low, interval.high)]


def contrast_document(found: Contrast | Referenced, confidence: float) -> dict[str, Any]:
    """Return an estimate with its interval and p value."""
    inside = found.interval(confidence)
    return {
        "value": found.value,
        "standard_error": found.standard_error,
        "low": inside.low,
        "high": inside.high,
        "p": found.p_value(),
    }


def _metric(one: "MetricGauge", confidence: float) -> dict[str, Any]:
    series, key = one.series, one.series.key
    document: dict[str, Any] = {
        "name": key.name,
        "unit": series.unit,
        "phase": key.phase,
        "qualifier": key.qualifier,
        "location": key.location,
        "lower": series.lower,
        "upper": series.upper,
        "tolerance": one.tolerance,
        "tolerance_of": one.tolerance_of or None,
        "runs": len(series.values),
        "missing": list(one.missing),
        "notes": list(one.notes),
        "why": one.why,
        "sensors": None,
        "appraisers": None,
        "trials": None,
        "anova": None,
        "average_range": None,
        "references": None if one.against is None else _against(one.against, confidence),
    }
    if one.study is not None and one.anova is not None and one.ranges is not None:
        document |= {
            "sensors": list(one.study.sensors),
            "appraisers": list(one.study.stations),
            "trials": one.study.shape[2],
            "anova": _anova(one.anova, one.study.appraiser),
            "average_range": {
                "mean_range": one.ranges.mean_range,
                "appraiser_range": one.ranges.station_range,
                "sensor_range": one.ranges.sensor_range,
                **_variation(one.ranges.variation),
            },
        }
    return document


def _anova(found: GaugeAnova, appraiser: str) -> dict[str, Any]:
    low, high = found.gauge_share.low, found.gauge_share.high
    return {
        "table": [
            {
                "source": source_of_variation(row.source, appraiser),
                "sum_of_squares": row.squares,
                "degrees_of_freedom": row.freedom,
                "mean_square": row.mean_square,
                "f": row.statistic,
                "p": row.p_value,
            }
            for row in found.table
        ],
        "interaction_pooled": found.pooled,
        "appraiser_variance": found.station.value,
        "interaction_variance": None if found.interaction is None else found.interaction.value,
        **_variation(found.variation),
        "gauge_percent_contribution_interval": [100 * low, 100 * high],
        "categories_interval": interval_document(found.categories),
    }


def _variation(found: Variation) -> dict[str, Any]:
    no_gauge = found.gauge.value == 0
    return {
        "components": {name: _variance(found, getattr(found, name)) for name in _PARTS},
        "categories": None if no_gauge else found.categories,
        "categories_uncut": None if no_gauge else found.categories_uncut,
        "notes": list(found.notes),
    }


def _variance(found: Variation, part: Variance) -> dict[str, Any]:
    return {
        "variance": part.value,
        "deviation": part.deviation,
        "variance_interval": interval_document(part.interval),
        "percent_contribution": found.percent_contribution(part),
        "percent_study": found.percent_study(part),
        "percent_tolerance": found.percent_tolerance(part),
        "percent_tolerance_interval": interval_document(found.tolerance_interval(part)),
    }


def _against(found: AgainstReferences, confidence: float) -> dict[str, Any]:
    return {
        "bias": [
            {
                "serial": one.reference.serial,
                "reference": one.reference.value,
                "unit": found.unit,
                "uncertainty": one.reference.uncertainty,
                "appraiser": one.appraiser,
                "runs": one.count,
                "bias": None if one.bias is None else contrast_document(one.bias, confidence),
                "why": one.why,
            }
            for one in found.biases
        ],
        "linearity": [
            {
                "appraiser": one.appraiser,
                **_linearity(one.linearity, confidence),
                "why": one.why,
            }
            for one in found.linearity
        ],
        "stability": [
            {
                "serial": one.reference.serial,
                "appraiser": one.appraiser,
                "drift_per_day": None
                if one.stability is None
                else contrast_document(one.stability.drift, confidence),
                "in_control": None if one.stability is None else one.stability.in_control,
                "why": one.why,
            }
            for one in found.stability
        ],
    }


def _linearity(found: Linearity | None, confidence: float) -> dict[str, Any]:
    if found is None:
        return {"slope": None, "intercept": None, "acceptable": None}
    return {
        "slope": contrast_document(found.rise(), confidence),
        "intercept": contrast_document(found.intercept, confidence),
        "acceptable": found.acceptable(confidence),
    }
