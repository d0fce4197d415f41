"""Control charts as one JSON document."""

from typing import TYPE_CHECKING, Any

from cbsr_qa.domain.run import ChartReference, StandingSignal

if TYPE_CHECKING:
    from cbsr_qa.studies.charts.charting import Charted, MetricChart
    from cbsr_qa.studies.charts.charts import Charts


def charts_document(found: "Charts") -> dict[str, Any]:
    """Return everything for ``--json``."""
    return {
        "station": found.request.station,
        "recipe": found.recipe,
        "golden": found.request.golden or None,
        "runs": found.runs,
        "in_control": not found.signals,
        "stored": found.stored,
        "simulated": found.simulated,
        "notes": list(found.notes),
        "charts": [_chart(one) for one in found.charts],
    }


def _chart(one: "MetricChart") -> dict[str, Any]:
    return {
        "label": one.label,
        "unit": one.unit,
        "why": one.why,
        "notes": list(one.notes),
        "reference": None if one.reference is None else reference_document(one.reference),
        "signal": None if one.signal is None else signal_document(one.signal),
        "runs": [line.run for line in one.lines],
        "reference_runs": one.phase_1,
        "values": list(one.values),
        "charts": [_points(charted, 0, one, "reference") for charted in one.before]
        + [_points(charted, one.phase_1, one, "monitored") for charted in one.after],
    }


def signal_document(signal: StandingSignal) -> dict[str, Any]:
    """Return a signal that stands."""
    return {
        "rules": list(signal.rules),
        "since_run": signal.since_run,
        "since": signal.since.isoformat(),
        "runs": signal.runs,
        "at_least": signal.at_least,
        "began_run": signal.began_run or None,
        "began": None if signal.began is None else signal.began.isoformat(),
    }


def reference_document(one: ChartReference) -> dict[str, Any]:
    """Return what limits rest on, and who set them."""
    settings = one.settings
    return {
        "reference": one.reference,
        "name": one.key.name,
        "phase": one.key.phase,
        "qualifier": one.key.qualifier,
        "location": one.key.location,
        "chart": str(settings.kind),
        "subgroup": settings.subgroup,
        "rules": list(settings.rules),
        "weight": settings.weight,
        "width": settings.width,
        "slack": settings.slack,
        "threshold": settings.threshold,
        "mean": one.mean,
        "deviation": one.deviation,
        "runs": one.runs,
        "first_run": one.first_run,
        "last_run": one.last_run,
        "operator": one.operator,
        "made_at": one.made_at.isoformat(),
        "why": one.why,
        "retired": one.retired,
    }


def _points(charted: "Charted", offset: int, one: "MetricChart", phase: str) -> dict[str, Any]:
    chart = charted.chart
    runs = [one.lines[offset + end].run for end in charted.ends]
    return {
        "name": chart.name,
        "phase": phase,
        "runs": runs,
        "points": chart.points.tolist(),
        "centre": chart.centre,
        "lower": chart.lower.tolist(),
        "upper": chart.upper.tolist(),
        "signals": [{"run": runs[signal.index], "rule": signal.rule} for signal in chart.signals],
    }
