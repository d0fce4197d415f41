"""The metrics of a gauge study, with its names, units and tolerances."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.results.fleet import FleetTable, MetricKey, RunLine
from cbsr_qa.report.tables import list_names
from cbsr_qa.studies.figure_series import Figures, Series, figures_of, series_of
from cbsr_qa.studies.gauge.request import GaugeRequest, MetricWanted
from cbsr_qa.studies.selection import missing_metric_error
from cbsr_qa.system.words import echo


@dataclass(frozen=True, slots=True)
class Toleranced:
    """One metric over the runs of a study, with its tolerance: that of the ``study`` or the ``recipe``, or None."""

    series: Series
    tolerance: float | None
    of: str


def choose_metrics(table: FleetTable, request: GaugeRequest, runs: Sequence[RunLine]) -> list[Toleranced]:
    """Return the metrics of a study, one series each.

    Raises
    ------
    RefusedError
        If no run measured a named metric (with the nearest one), it has another unit than stated, it has no locations
        though these are requested, or nothing was measured.
    """
    _check_known(request, {kind.key for kind in table.kinds})
    figures = _select_locations(request, figures_of(table, by_location=request.by_location))
    series = series_of(runs, figures, tuple(dict.fromkeys(metric.name for metric in request.metrics)))
    metrics = [toleranced for of_metric in series for toleranced in _add_tolerance(request, of_metric)]
    if not metrics:
        raise RefusedError("none of these runs has measurements", remedy="choose runs that were finished")
    _check_references(request, runs, metrics)
    return metrics


def _check_known(request: GaugeRequest, known: set[MetricKey]) -> None:
    for index, metric in enumerate(request.metrics):
        if not known or any(metric.means(key) for key in known):
            continue
        origin = request.locate("metrics", index, "name")
        same_name_keys = [key for key in sorted(known) if key.name == metric.name]
        if not same_name_keys:
            raise missing_metric_error(metric.name, {key.name for key in known}, origin)
        variants = dict.fromkeys(f"phase {key.phase!r}, qualifier {key.qualifier!r}" for key in same_name_keys)
        raise RefusedError(
            f"{origin}no run of these measured {metric.name} of "
            f"{f'phase {echo(metric.phase)} and ' if metric.phase else ''}qualifier {echo(metric.qualifier or '')}",
            remedy=f"measured: {'; '.join(variants)}",
        )


def _select_locations(request: GaugeRequest, figures: Figures) -> Figures:
    if not request.by_location or not figures:
        return figures
    names = {metric.name for metric in request.metrics}
    located = {
        key: figures_by_run
        for key, figures_by_run in figures.items()
        if key.location and (not names or key.name in names)
    }
    if not located:
        raise RefusedError(
            f"{request.locate('study', 'by_location')}these metrics are not of locations",
            remedy="leave out --by-location (by_location in the study), or name a metric of locations",
        )
    return located


def _add_tolerance(request: GaugeRequest, series: Series) -> Iterator[Toleranced]:
    """A series with the tolerance of the study or its own; nothing for a variant that was not named."""
    if not request.metrics:
        yield _with_limits(series, MetricWanted(series.key.name))
        return
    for index, metric in enumerate(request.metrics):
        if not metric.means(series.key):
            continue
        if metric.unit and metric.unit != series.unit:
            raise _refuse_unit(request.locate("metrics", index, "unit"), metric.unit, series)
        yield _with_limits(series, metric)
        return


def _with_limits(series: Series, wanted: MetricWanted) -> Toleranced:
    if wanted.width is not None:
        return Toleranced(replace(series, lower=wanted.lower, upper=wanted.upper), wanted.width, "study")
    tolerance = series.tolerance
    # Coinciding limits leave no width.
    return Toleranced(series, tolerance, "recipe") if tolerance else Toleranced(series, None, "")


def _refuse_unit(at: str, unit: str, series: Series) -> RefusedError:
    return RefusedError(
        f"{at}the unit is {echo(unit)}, but {series.key.label} was measured in {series.unit}",
        remedy=f"state the numbers in {series.unit}; nothing is converted",
    )


def _check_references(request: GaugeRequest, lines: Sequence[RunLine], metrics: Sequence[Toleranced]) -> None:
    studied_names, serials = {metric.series.key.name for metric in metrics}, {line.serial for line in lines}
    for index, reference in enumerate(request.references):
        if reference.metric not in studied_names:
            origin = request.locate("reference", index, "metric")
            raise RefusedError(
                f"{origin}there is a reference value of {echo(reference.metric)}, which is not studied",
                remedy=f"studied: {', '.join(sorted(studied_names))}; name others as metrics",
            )
        if reference.serial not in serials:
            raise RefusedError(
                f"{request.locate('reference', index, 'serial')}there is a reference value of sensor "
                f"{echo(reference.serial, 64)}, which has no run in this study",
                remedy=f"sensors: {list_names(sorted(serials))}",
            )
        for metric_of_reference in metrics:
            if metric_of_reference.series.key.name == reference.metric and reference.unit not in (
                "",
                metric_of_reference.series.unit,
            ):
                raise _refuse_unit(
                    request.locate("reference", index, "unit"), reference.unit, metric_of_reference.series
                )
