"""What decides: the limits that were not met, and what the sensor does; then every limit and measurement."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final

from cbsr_qa.calibration.abilities import describe_abilities
from cbsr_qa.plugin import (
    SEVERITY,
    Block,
    Cell,
    Figure,
    LimitsVersion,
    Measurement,
    Outcome,
    Paragraph,
    RunResult,
    Table,
    metric_words,
    relative_margin,
)
from cbsr_qa.report.draw.images import verdict_figure
from cbsr_qa.report.location_verdicts import SIGNS, location_verdicts, outcome_counts, verdicts_in_words
from cbsr_qa.report.section import RunSection
from cbsr_qa.report.select import alike, spread_text
from cbsr_qa.report.tables import (
    limit_text,
    margin_text,
    plural,
    sign_of_bound,
    text_table,
    unit_column,
    value_cell,
    with_uncertainty,
)

#: A measurement with more qualifiers than this gets one row for all of them.
_MAX_QUALIFIERS: Final = 8
#: Of more limits than this only the closest ones, and all that were not passed, are shown unfolded.
_MAX_LIMITS: Final = 60
_CLOSEST: Final = 24
#: On the first page: the closest limits of a sensor that met them all, and the most of one that did not.
_CLOSEST_ON_PAGE_ONE: Final = 3
_MOST_ON_PAGE_ONE: Final = 16
#: Phases that fit a page beside each other.
_MAX_PHASES: Final = 4


class Decision(RunSection):
    """The first page of a run's report: every limit that was not clearly met, and what the sensor does."""

    title = "Decision"
    leaf = 1

    def blocks(self, result: RunResult) -> Iterator[Block]:
        """Return the limits that were not clearly met, worst first, or the closest ones; then the abilities."""
        judged = _sort_by_severity([m for m in result.measurements if m.limit is not None])
        unmet = [m for m in judged if m.outcome is not Outcome.PASS]
        if judged:
            yield Paragraph(_count_outcomes(judged))
            closest = judged[:_CLOSEST_ON_PAGE_ONE]
            caption = "Limits not met, or barely; the worst comes first." if unmet else "Closest to failing."
            shown, strains = unmet[:_MOST_ON_PAGE_ONE] or closest, _with_strains(judged)
            yield _limit_table(result, caption, shown, strains, code_words=False)  # they are in the head
        if len(unmet) > _MOST_ON_PAGE_ONE:
            yield Paragraph(f"{plural(len(unmet) - _MOST_ON_PAGE_ONE, 'more limit')}: see annex Limits.", "note")
        yield from map(Paragraph, _describe_errors(result))
        if result.calibration is not None:
            yield from map(Paragraph, describe_abilities(result.calibration))


def _describe_errors(result: RunResult) -> Iterator[str]:
    """Say how well loads were read that nothing was learned from, and how well presses were placed."""
    known = [m for m in result.measurements if m.name == "force_error_sd" and m.qualifier == "place known"]
    if known and known[0].value is not None:
        words = with_uncertainty(known[0].value, known[0].uncertainty)
        yield f"Forces of loads that it was not calibrated with were off by {words} N (standard deviation)."
    located = [m for m in result.measurements if m.name == "centre_of_mass_error" and not m.qualifier]
    errors_mm = [m.value for m in located if m.value is not None]
    if errors_mm:
        presses = f"{len(errors_mm)} of {plural(len(located), 'press', 'presses')}"
        yield f"Images showed {presses}, {spread_text(errors_mm, 'mm')} mm from where they were."


class Limits(RunSection):
    """Section of all limits and measurements, of any plugin."""

    title = "Limits and measurements"

    def blocks(self, result: RunResult) -> Iterator[Block]:
        """Return limits in words, by location and as a table, then everything else that was measured."""
        if not result.measurements:
            return
        judged = [m for m in result.measurements if m.limit is not None]
        others = [m for m in result.measurements if m.limit is None]
        if judged:
            yield Paragraph(f"{_count_outcomes(judged)} The closest to failing comes first.")
        else:
            yield Paragraph("The recipe sets no limit on anything that was measured.")
        if result.limits_version is not None:
            yield Paragraph(_version_words(result.limits_version, judged))
        if judged:
            yield from (*_location_blocks(result, judged), *_limit_tables(result, judged))
        determined = [m for m in others if m.value is not None]
        # Apart: as columns beside each other they do not fit a page.
        for part in ([m for m in determined if m.phase], [m for m in determined if not m.phase]):
            yield from _others(part)
        refused = [m for m in others if m.value is None]
        if refused:
            yield _refusal_table(refused)


def _location_blocks(result: RunResult, judged: Sequence[Measurement]) -> list[Block]:
    """Which places met their limits; nothing where no single load was judged."""
    run = result.observation
    verdicts = () if run is None else location_verdicts(run, judged)
    if run is None or not verdicts:
        return []
    words = verdicts_in_words(verdicts)
    caption = (
        "Outcome of each place: the worst of its trials and strains. ✓ pass, ≈ marginal, ✗ fail, ? not measured."
        " Limits of the whole run are in the table only."
    )
    return [Paragraph(words), Figure(caption, words, verdict_figure(verdicts, run.record.sensor_type))]


def _version_words(version: LimitsVersion, judged: Sequence[Measurement]) -> str:
    """Describe the origin and the guarantee of versioned limits."""
    members = sum(m.limit is not None and m.limit.version == version.version for m in judged)
    lot = f" from the golden lot {version.lot}" if version.lot else ""
    words = f"{plural(members, 'limit')} of version {version.version}, made {version.date}{lot}."
    if version.coverage_percent is not None and version.confidence_percent is not None:
        share = f"{version.coverage_percent:g} % of good sensors with {version.confidence_percent:g} % confidence"
        words += f" Each limit by itself passes {share}."
    if version.rule:
        words += f" Decision rule: {version.rule}."
    return words if version.sealed else f"{words} They may have been changed since."


def _count_outcomes(judged: Sequence[Measurement]) -> str:
    return f"{plural(len(judged), 'limit')} judged: {outcome_counts([m.outcome for m in judged])}."


def _sort_by_severity(judged: Sequence[Measurement]) -> list[Measurement]:
    return sorted(judged, key=lambda m: (SEVERITY.index(m.outcome), relative_margin(m)))


def _limit_tables(result: RunResult, judged: Sequence[Measurement]) -> list[Table]:
    order, strains = _sort_by_severity(judged), _with_strains(judged)
    caption = "Limits. Margin: distance from the nearer bound, negative outside."
    if len(order) <= _MAX_LIMITS:
        return [_limit_table(result, caption, order, strains)]
    first = max(_CLOSEST, sum(m.outcome is not Outcome.PASS for m in order))
    rest = _limit_table(result, "The other limits, all further from failing.", order[first:], strains)
    return [_limit_table(result, caption, order[:first], strains), replace(rest, folded=True)]


def _limit_table(
    result: RunResult,
    caption: str,
    judged: Sequence[Measurement],
    strains: frozenset[str],
    *,
    code_words: bool = True,
) -> Table:
    versioned = any(m.limit and m.limit.version for m in judged)
    columns = ("Measurement", "Phase", "Value", "Limit", "Margin", "Outcome", *(("Version",) if versioned else ()))
    rows = [_limit_row(m, m.phase in strains, versioned) for m in judged]
    codes = ["; ".join(code.words if code_words else code.code for code in result.codes_of(m)) for m in judged]
    if any(codes):
        columns, rows = (*columns, "Code"), [[*row, code] for row, code in zip(rows, codes, strict=True)]
    return text_table(caption, columns, rows, (2, 3, 4))


def _with_strains(measurements: Sequence[Measurement]) -> frozenset[str]:
    """Phases in which loads of one name were pressed at several strains: their name alone says too little."""
    strains_of: dict[tuple[str, str], set[float]] = {}
    for m in measurements:
        if m.strain is not None:
            strains_of.setdefault((m.phase, m.location), set()).add(m.strain)
    return frozenset(phase for (phase, _), strains in strains_of.items() if len(strains) > 1)


def _limit_row(m: Measurement, strains: bool, versioned: bool) -> list[str | Cell]:
    assert m.limit is not None
    sign = f"{SIGNS[m.outcome]}\N{NO-BREAK SPACE}" if m.outcome in SIGNS else ""
    outcome = Cell(f"{sign}{m.outcome.value}", m.outcome)
    value = Cell(value_cell(m, unit=True).text)
    name = f"{m.label} at {100 * m.strain:.3g} % strain" if strains and m.strain is not None else m.label
    name += f": {m.how}" if m.outcome is Outcome.NOT_MEASURED and m.how else ""
    version = [m.limit.version or "–"] if versioned else []
    return [name, m.phase or "whole run", value, limit_text(m.limit), margin_text(m), outcome, *version]


def _others(measurements: Sequence[Measurement]) -> list[Table]:
    """Tables of what no limit judges, a few phases a table: more columns do not fit a page."""
    phases = list(dict.fromkeys(m.phase for m in measurements))
    count = -(-len(phases) // _MAX_PHASES)
    parts = [phases[k * len(phases) // count : (k + 1) * len(phases) // count] for k in range(count)]
    return [_others_of([m for m in measurements if m.phase in part], part) for part in parts]


def _others_of(measurements: Sequence[Measurement], phases: Sequence[str]) -> Table:
    rows = [
        [name, *(_summary([m for m in members if m.phase == phase]) for phase in phases)]
        for name, members in _group_measurements(measurements).items()
    ]
    columns = ("Measurement", *(phase or "whole run" for phase in phases))
    where = "of each phase" if any(phases) else "of the whole run"
    caption = (
        f"Measurements {where} without a limit. Several values: mean ± standard deviation (number of values); one"
        " value: with its uncertainty."
    )
    return text_table(caption, columns, rows, tuple(range(1, len(columns))))


def _group_measurements(measurements: Sequence[Measurement]) -> dict[str, list[Measurement]]:
    """Group what belongs in one row; a measurement with many qualifiers (one per electrode pair) is one row."""
    qualifiers: dict[str, set[str]] = {}
    for m in measurements:
        qualifiers.setdefault(m.name, set()).add(m.qualifier)
    groups: dict[str, list[Measurement]] = {}
    for m in measurements:
        words = metric_words(m.name)
        separate = 1 < len(qualifiers[m.name]) <= _MAX_QUALIFIERS or qualifiers[m.name] == {m.qualifier}
        title = f"{words} ({m.qualifier})" if m.qualifier and separate else words
        groups.setdefault(unit_column(title, m.unit), []).append(m)
    return groups


def _summary(members: Sequence[Measurement]) -> str:
    values = [m.value for m in members if m.value is not None]
    if not values:
        return ""
    if len(values) == 1:
        return value_cell(members[0]).text
    return f"{sign_of_bound(members)}{spread_text(values, members[0].unit)} ({len(values)})"


def _refusal_table(measurements: Sequence[Measurement]) -> Table:
    groups: dict[tuple[str, str, str], list[Measurement]] = {}
    for m in measurements:
        groups.setdefault((m.name, m.phase, alike(m.how)), []).append(m)
    rows = []
    for (name, phase, _), members in groups.items():
        why = members[0].how if len({m.how for m in members}) == 1 else f"for example: {members[0].how}"
        rows.append([metric_words(name), phase or "whole run", _describe_places(members), why])
    return text_table("What could not be measured, and why.", ("Measurement", "Phase", "Where", "Why"), rows)


def _describe_places(members: Sequence[Measurement]) -> str:
    """Name locations and qualifiers, each once: ``R0, R2 (image, loading; image, unloading)``."""
    places = ", ".join(dict.fromkeys(m.location for m in members if m.location))
    kinds = "; ".join(dict.fromkeys(m.qualifier for m in members if m.qualifier))
    if places and kinds:
        return f"{places} ({kinds})"
    return places or kinds or "–"
