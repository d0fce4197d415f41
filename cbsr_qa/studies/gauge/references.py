"""Reference values of golden sensors, as options or a file, and a gauge compared with them."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import timedelta
from math import isfinite
from pathlib import Path
from typing import Annotated

from pydantic import Field

from cbsr_qa.config.documents import DocumentKind, open_document
from cbsr_qa.config.tables import FileModel, validate
from cbsr_qa.domain.errors import NumericsError, RefusedError
from cbsr_qa.domain.filling import fill_from_object
from cbsr_qa.domain.results.fleet import RunLine
from cbsr_qa.plugin.problems import Table
from cbsr_qa.stats.gauge.reference import bias, linearity, stability
from cbsr_qa.stats.gauge.type1 import study_type1
from cbsr_qa.stats.process_capability import Index
from cbsr_qa.stats.samples import Estimate
from cbsr_qa.studies.figure_series import Series
from cbsr_qa.studies.selection import clock_notes
from cbsr_qa.system.words import echo

_GIVEN = re.compile(
    r"(?P<serial>.+)\.(?P<metric>[a-z][a-z0-9_]*)=(?P<value>[^±\s]+?)\s*"
    r"(?:(?:±|\+/?-)\s*(?P<u>[^±\s]+))?(?:\s+(?P<unit>\S{1,16}))?"
)


@dataclass(frozen=True, slots=True)
class ReferenceValue:
    """A sensor's true value, known independently.

    Parameters
    ----------
    value, uncertainty : reference value and its standard deviation in ``unit``; 0 if not stated.
    unit : unit of the metric; empty if an option omits it, which means the metric's unit (named in sentences).
    """

    serial: str
    metric: str
    value: float
    uncertainty: float = 0.0
    unit: str = ""


@dataclass(frozen=True, slots=True)
class Bias:
    """Mean reading of one appraiser minus one reference.

    Parameters
    ----------
    reference, uncertainty : reference value of the sensor and its uncertainty, in ``unit``.
    runs : number of readings.
    bias : None for the reason ``why``.
    """

    serial: str
    reference: float
    uncertainty: float
    unit: str
    appraiser: str
    runs: int
    bias: Estimate | None
    why: str = ""


@dataclass(frozen=True, slots=True)
class BiasLinearity:
    """Bias of one appraiser as a function of the value.

    Parameters
    ----------
    slope, intercept : None for the reason ``why``.
    references : the smallest and the largest.
    acceptable : whether zero lies within the confidence band of the bias at every reference.
    """

    appraiser: str
    slope: Estimate | None = None
    intercept: Estimate | None = None
    references: tuple[float, float] | None = None
    acceptable: bool | None = None
    why: str = ""


@dataclass(frozen=True, slots=True)
class BiasStability:
    """Stability of the bias of one appraiser at one reference.

    Parameters
    ----------
    drift_per_day : None for the reason ``why``.
    in_control : whether a control chart of the bias gives no signal; None with too few readings.
    signal : the rule that was broken first; empty without a signal.
    """

    serial: str
    appraiser: str
    drift_per_day: Estimate | None = None
    in_control: bool | None = None
    signal: str = ""
    why: str = ""


@dataclass(frozen=True, slots=True)
class Type1:
    """Type 1 study of one appraiser at one reference.

    Parameters
    ----------
    tolerance : width of the metric's limits, in its unit.
    cg, cgk : indices of repeatability, and of repeatability and bias; None for the reason ``why``.
    capable : whether both are shown to reach 1.33; None if that is not shown.
    """

    serial: str
    appraiser: str
    runs: int
    tolerance: float
    cg: Index | None = None
    cgk: Index | None = None
    capable: bool | None = None
    why: str = ""


@dataclass(frozen=True, slots=True)
class AgainstReferences:
    """One metric compared with reference values; ``type1`` is empty for a metric without a tolerance."""

    bias: tuple[Bias, ...]
    linearity: tuple[BiasLinearity, ...]
    stability: tuple[BiasStability, ...]
    type1: tuple[Type1, ...]


_Name = Annotated[str, Field(min_length=1, max_length=64)]


class ReferenceTable(Table):
    """``[[reference]]``: the value of one metric of one golden sensor, in the metric's unit."""

    serial: _Name
    metric: _Name
    unit: Annotated[str, Field(min_length=1, max_length=16)]
    value: float
    uncertainty: Annotated[float, Field(ge=0)] = 0.0

    def to_domain(self) -> ReferenceValue:
        return fill_from_object(ReferenceValue, self)


class _ReferenceFile(FileModel[tuple[ReferenceValue, ...]]):
    reference: Annotated[list[ReferenceTable], Field(min_length=1)]

    def to_domain(self) -> tuple[ReferenceValue, ...]:
        return tuple(table.to_domain() for table in self.reference)


def references_of(given: Sequence[str]) -> tuple[ReferenceValue, ...]:
    """Read reference values: ``SERIAL.METRIC=VALUE±U UNIT``, or names of TOML files.

    RefusedError if one cannot be read, or one sensor has two values of one metric.
    """
    references: list[ReferenceValue] = []
    for text in given:
        if text.endswith(".toml"):
            read_values = validate(_ReferenceFile, open_document(DocumentKind.REFERENCES, Path(text)))
            references += read_values
        else:
            references.append(_parse_option(text))
    keys = [(reference.serial, reference.metric) for reference in references]
    for key in keys:
        if keys.count(key) > 1:
            raise RefusedError(
                f"sensor {key[0]} has {keys.count(key)} reference values of {key[1]}", remedy="give one"
            )
    return tuple(references)


def _parse_option(text: str) -> ReferenceValue:
    remedy = (
        "write 'SERIAL.METRIC=VALUE±UNCERTAINTY UNIT', e.g. 'G-01.force_gain=10.6±0.02 N/V', or name a .toml file"
    )
    match = _GIVEN.fullmatch(text.strip())
    if match is None:
        raise RefusedError(f"--reference {echo(text)} cannot be read", remedy=remedy)
    try:
        value, uncertainty = float(match["value"]), float(match["u"] or 0)
    except ValueError as error:
        raise RefusedError(f"--reference {echo(text)}: {error}", remedy=remedy) from error
    if not (isfinite(value) and isfinite(uncertainty) and uncertainty >= 0):
        raise RefusedError(
            f"--reference {echo(text)}: allowed are finite values, uncertainties from 0", remedy=remedy
        )
    return ReferenceValue(match["serial"], match["metric"], value, uncertainty, match["unit"] or "")


def compare_references(
    series: Series,
    appraisers: Sequence[str],
    references: Sequence[ReferenceValue],
    confidence: float,
    tolerance: float | None = None,
) -> AgainstReferences | None:
    """Compare the runs of one metric with its reference values; None without any."""
    metric_references = [reference for reference in references if reference.metric == series.key.name]
    if not metric_references:
        return None
    rows = list(zip(series.lines, series.values, appraisers, strict=True))
    biases, stabilities, type1_studies = [], [], []
    for reference in metric_references:
        sensor_rows = [(line, value, appraiser) for line, value, appraiser in rows if line.serial == reference.serial]
        for appraiser in sorted({appraiser for _, _, appraiser in sensor_rows}):
            lines, values = zip(
                *((line, value) for line, value, row_appraiser in sensor_rows if row_appraiser == appraiser),
                strict=True,
            )
            biases.append(_bias(reference, series.unit, appraiser, values, confidence))
            stabilities.append(_stability(reference, appraiser, lines, values, confidence))
            if tolerance is not None:
                type1_studies.append(_type1(reference, appraiser, values, tolerance, confidence))
        if not sensor_rows:
            biases.append(_bias(reference, series.unit, "", (), confidence))
    measuring_appraisers = sorted(
        {
            appraiser
            for line, _, appraiser in rows
            if line.serial in {reference.serial for reference in metric_references}
        }
    )
    slopes = tuple(
        _linearity(metric_references, [row for row in rows if row[2] == appraiser], appraiser, confidence)
        for appraiser in measuring_appraisers
    )
    return AgainstReferences(tuple(biases), slopes, tuple(stabilities), tuple(type1_studies))


def _bias(reference: ReferenceValue, unit: str, who: str, values: Sequence[float], confidence: float) -> Bias:
    estimate, why = None, ""
    if not values:
        why = "no run in this study is of that sensor"
    else:
        try:
            estimate = bias(values, reference.value, uncertainty=reference.uncertainty).estimate(confidence)
        except NumericsError as error:
            why = error.reason
    return Bias(reference.serial, reference.value, reference.uncertainty, unit, who, len(values), estimate, why)


def _type1(
    reference: ReferenceValue, who: str, values: Sequence[float], tolerance: float, confidence: float
) -> Type1:
    without_indices = Type1(reference.serial, who, len(values), tolerance)
    try:
        study = study_type1(
            values, reference.value, tolerance, uncertainty=reference.uncertainty, confidence=confidence
        )
    except NumericsError as error:
        return replace(without_indices, why=error.reason)
    return replace(without_indices, cg=study.cg, cgk=study.cgk, capable=study.capable())


def _stability(
    reference: ReferenceValue, who: str, lines: Sequence[RunLine], values: Sequence[float], confidence: float
) -> BiasStability:
    without_estimate = BiasStability(reference.serial, who)
    clock_faults = clock_notes(lines)
    if clock_faults:
        return replace(without_estimate, why=f"no drift can be estimated: {clock_faults[0]}")
    days = [(line.started_at - lines[0].started_at) / timedelta(days=1) for line in lines]
    try:
        over_time = stability(days, values, reference.value)
    except NumericsError as error:
        return replace(without_estimate, why=error.reason)
    signal = over_time.chart.signals[0].rule if over_time.chart.signals and over_time.in_control is False else ""
    return replace(
        without_estimate,
        drift_per_day=over_time.drift.estimate(confidence),
        in_control=over_time.in_control,
        signal=str(signal),
    )


def _linearity(
    references: Sequence[ReferenceValue], rows: Sequence[tuple[RunLine, float, str]], who: str, confidence: float
) -> BiasLinearity:
    """Fit one appraiser's readings; pooled ones would count differences between stations as scatter."""
    readings = {
        reference: [value for line, value, _ in rows if line.serial == reference.serial] for reference in references
    }
    pairs = [(true.value, value) for true, values in readings.items() for value in values]
    reference_uncertainties = [
        (len(values), true.value, true.uncertainty) for true, values in readings.items() if values
    ]
    try:
        fitted = linearity([true for true, _ in pairs], [value for _, value in pairs], known=reference_uncertainties)
    except NumericsError as error:
        return BiasLinearity(who, why=f"{error.reason}; {error.remedy}" if error.remedy else error.reason)
    slope, intercept = fitted.rise().estimate(confidence), fitted.intercept.estimate(confidence)
    ends = fitted.references[0], fitted.references[-1]
    return BiasLinearity(who, slope, intercept, ends, fitted.acceptable(confidence))
