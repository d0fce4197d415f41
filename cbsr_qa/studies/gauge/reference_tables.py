"""Tables of a gauge held against reference values: bias, linearity, stability, and type 1 studies."""

from collections.abc import Callable, Iterator, Sequence
from typing import Final, TypeVar

from cbsr_qa.domain.results.report import Table
from cbsr_qa.report.tables import format_fixed, list_names, number, text_table, unit_column, with_uncertainty
from cbsr_qa.stats.gauge.reference import FEWEST_CHARTED
from cbsr_qa.stats.gauge.type1 import CAPABLE, SHARE_OF_TOLERANCE
from cbsr_qa.stats.samples import Estimate
from cbsr_qa.studies.gauge.references import AgainstReferences, Bias, BiasLinearity, BiasStability, Type1
from cbsr_qa.studies.gauge.study import GaugeStudy

_NONE: Final = "–"


def list_reference_tables(references: AgainstReferences, unit: str, of: GaugeStudy) -> Iterator[Table]:
    """Yield a table for each comparison of a metric with its reference values that was made."""
    interval_column, appraiser = f"{100 * of.confidence:g} % interval", of.appraiser
    columns: tuple[str, ...] = ("sensor", appraiser, unit_column("reference", unit), "runs")
    columns += (unit_column("bias", unit), interval_column, "p", "result")
    yield from _table("Bias against reference values", columns, references.bias, _bias, range(2, 7))
    columns = (
        appraiser,
        "slope of the bias",
        interval_column,
        unit_column("references", unit),
        "bias depends on value",
        "bias",
    )
    yield from _table("Linearity of the bias", columns, references.linearity, _linearity, range(1, 4))
    columns = ("sensor", appraiser, unit_column("drift per day", unit), interval_column, "control chart")
    yield from _table("Stability over time", columns, references.stability, _stability, range(2, 4))
    columns = (
        "sensor",
        appraiser,
        "runs",
        "Cg",
        interval_column,
        "Cgk",
        interval_column,
        f"both {CAPABLE:g} or more",
    )
    title = (
        f"Type 1 study: {100 * SHARE_OF_TOLERANCE:g} % of the tolerance over six standard deviations (Cg), less the"
    )
    yield from _table(f"{title} bias (Cgk)", columns, references.type1, _type1, range(2, 7))


_Row = TypeVar("_Row", Bias, BiasLinearity, BiasStability, Type1)


def _table(
    what: str,
    columns: tuple[str, ...],
    rows: Sequence[_Row],
    cells: Callable[[_Row], tuple[str, ...]],
    numeric: range,
) -> Iterator[Table]:
    """Lay out rows, if any; a reason shared by many unknown rows is given once."""
    whys = tuple(dict.fromkeys(row.why for row in rows if row.why))
    caption = f"{what}; {_NONE}: {list_names(whys)}." if whys else f"{what}."
    if rows:
        yield text_table(caption, columns, [cells(row) for row in rows], numeric)


def _bias(bias: Bias) -> tuple[str, ...]:
    reference = with_uncertainty(bias.reference, bias.uncertainty)
    first_cells = (bias.serial, bias.appraiser or _NONE, reference, str(bias.runs))
    if bias.bias is None:
        return *first_cells, *[_NONE] * 4
    return (
        *first_cells,
        *_format_estimate(bias.bias),
        number(bias.bias.p, 2),
        "not significant" if bias.bias.holds_zero else "biased",
    )


def _linearity(linearity: BiasLinearity) -> tuple[str, ...]:
    if linearity.slope is None or linearity.references is None:
        return linearity.appraiser, *[_NONE] * 5
    ends = " to ".join(map(number, linearity.references))
    depends = "not significant" if linearity.slope.holds_zero else "yes"
    return (
        linearity.appraiser,
        *_format_estimate(linearity.slope),
        ends,
        depends,
        "not significant" if linearity.acceptable else "yes",
    )


def _stability(stability: BiasStability) -> tuple[str, ...]:
    if stability.drift_per_day is None:
        return stability.serial, stability.appraiser, *[_NONE] * 3
    chart = f"fewer than {FEWEST_CHARTED} runs" if stability.in_control is None else stability.signal or "in control"
    return stability.serial, stability.appraiser, *_format_estimate(stability.drift_per_day), chart


def _type1(study: Type1) -> tuple[str, ...]:
    first_cells = (study.serial, study.appraiser, str(study.runs))
    if study.cg is None or study.cgk is None:
        return *first_cells, *[_NONE] * 5
    indices = [
        cell
        for index in (study.cg, study.cgk)
        for cell in (format_fixed(index.value, 2), f"{format_fixed(index.low, 2)} to {format_fixed(index.high, 2)}")
    ]
    capable = "not shown" if study.capable is None else "yes" if study.capable else "no"
    return *first_cells, *indices, capable


def _format_estimate(estimate: Estimate) -> tuple[str, str]:
    return number(estimate.value), f"{number(estimate.low)} to {number(estimate.high)}"
