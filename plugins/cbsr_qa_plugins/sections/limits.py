"""Every limit with its value, margin and outcome, and every other measurement."""

from collections.abc import Sequence
from typing import Final

from cbsr_qa.domain.limits_version import LimitsVersion
from cbsr_qa.domain.load_events import RecordingResult
from cbsr_qa.domain.measurement import Measurement, relative_margin
from cbsr_qa.domain.outcome import SEVERITY, Outcome
from cbsr_qa.domain.report import Block, Cell, Paragraph, RunResult, Section, Table
from cbsr_qa.report.numbers import plural
from cbsr_qa.report.select import alike, spread_text
from cbsr_qa.report.tables import bound_sign, limit_text, margin_text, text_table, unit_column, value_cell

#: A measurement with more qualifiers than this gets one row for all of them.
_MOST_QUALIFIERS: Final = 8


class Limits:
    """Section that lists everything that was measured, whoever's plugin measured it."""

    def render(self, result: RunResult | RecordingResult) -> Section | None:
        """Return the section; None for a recording, or where nothing was measured."""
        if not isinstance(result, RunResult) or not result.measurements:
            return None
        judged = [m for m in result.measurements if m.limit is not None]
        others = [m for m in result.measurements if m.limit is None]
        blocks: list[Block] = [Paragraph(_in_words(judged))]
        if result.limits_version is not None:
            blocks.append(Paragraph(_version_words(result.limits_version, judged)))
        if judged:
            blocks.append(_judged(judged))
        determined = [m for m in others if m.value is not None]
        # Apart: as columns beside each other they do not fit a page.
        for part in ([m for m in determined if m.phase], [m for m in determined if not m.phase]):
            if part:
                blocks.append(_others(part))
        refused = [m for m in others if m.value is None]
        if refused:
            blocks.append(_refused(refused))
        return Section("Limits and measurements", tuple(blocks))


def _in_words(judged: Sequence[Measurement]) -> str:
    if not judged:
        return "The recipe sets no limit on anything that was measured."
    counts = [(outcome, sum(m.outcome is outcome for m in judged)) for outcome in reversed(SEVERITY)]
    words = ", ".join(f"{count} {outcome.value}" for outcome, count in counts if count)
    return f"{plural(len(judged), 'limit')} judged: {words}. The closest to failing comes first."


def _version_words(version: LimitsVersion, judged: Sequence[Measurement]) -> str:
    """Say where the limits come from that carry a version, and what they promise."""
    members = sum(m.limit is not None and m.limit.version == version.version for m in judged)
    lot = f" from the golden lot {version.lot}" if version.lot else ""
    words = f"{plural(members, 'limit')} of version {version.version}, made {version.date}{lot}."
    if version.coverage_percent is not None and version.confidence_percent is not None:
        share = f"{version.coverage_percent:g} % of good sensors with {version.confidence_percent:g} % confidence"
        words += f" Each by itself was made to pass {share}."
    if version.rule:
        words += f" Decision rule: {version.rule}."
    return words if version.sealed else f"{words} Nothing vouches that they are still as they were made."


def _judged(judged: Sequence[Measurement]) -> Table:
    order = sorted(judged, key=lambda m: (SEVERITY.index(m.outcome), relative_margin(m)))
    versioned = ("Version",) if any(m.limit and m.limit.version for m in judged) else ()
    rows: list[list[str | Cell]] = []
    for m in order:
        assert m.limit is not None
        signs = {Outcome.PASS: "✓ ", Outcome.FAIL: "✗ ", Outcome.MARGINAL: "≈ ", Outcome.NOT_MEASURED: "? "}
        outcome = Cell(f"{signs.get(m.outcome, '')}{m.outcome.value}", m.outcome)
        value = Cell(value_cell(m, unit=True).text)
        why = m.how if m.outcome is Outcome.NOT_MEASURED else ""
        name = f"{m.label}: {why}" if why else m.label
        row: list[str | Cell] = [name, m.phase or "whole run", value, limit_text(m.limit), margin_text(m), outcome]
        rows.append([*row, m.limit.version or "–"] if versioned else row)
    columns = ("Measurement", "Phase", "Value", "Limit", "Margin", "Outcome", *versioned)
    return text_table("Limits. Margin: distance from the nearer bound, negative outside.", columns, rows, (2, 3, 4))


def _others(measurements: Sequence[Measurement]) -> Table:
    phases = list(dict.fromkeys(m.phase for m in measurements))
    rows = [_row(name, members, phases) for name, members in _grouped(measurements).items()]
    columns = ("Measurement", *(phase or "whole run" for phase in phases))
    where = "in a phase" if any(phases) else "of the whole run"
    caption = (
        f"Everything else that was measured {where}; no limit was set for it. Several values are given as mean ±"
        " standard deviation with their number, a single one with its own uncertainty."
    )
    return text_table(caption, columns, rows, tuple(range(1, len(columns))))


def _grouped(measurements: Sequence[Measurement]) -> dict[str, list[Measurement]]:
    """Group what belongs in one row; a measurement with many qualifiers (one per electrode pair) is one row."""
    qualifiers: dict[str, set[str]] = {}
    for m in measurements:
        qualifiers.setdefault(m.name, set()).add(m.qualifier)
    groups: dict[str, list[Measurement]] = {}
    for m in measurements:
        words = m.name.replace("_", " ").replace("snr", "SNR")
        each = 1 < len(qualifiers[m.name]) <= _MOST_QUALIFIERS or qualifiers[m.name] == {m.qualifier}
        title = f"{words} ({m.qualifier})" if m.qualifier and each else words
        groups.setdefault(unit_column(title, m.unit), []).append(m)
    return groups


def _row(name: str, members: Sequence[Measurement], phases: Sequence[str]) -> list[str]:
    return [name, *(_summary([m for m in members if m.phase == phase]) for phase in phases)]


def _summary(members: Sequence[Measurement]) -> str:
    values = [m.value for m in members if m.value is not None]
    if not values:
        return ""
    if len(values) == 1:
        return value_cell(members[0]).text
    return f"{bound_sign(members)}{spread_text(values, members[0].unit)} ({len(values)})"


def _refused(measurements: Sequence[Measurement]) -> Table:
    groups: dict[tuple[str, str, str], list[Measurement]] = {}
    for m in measurements:
        groups.setdefault((m.name, m.phase, alike(m.how)), []).append(m)
    rows = []
    for (name, phase, _), members in groups.items():
        why = members[0].how if len({m.how for m in members}) == 1 else f"for example: {members[0].how}"
        rows.append([name.replace("_", " "), phase or "whole run", _where(members), why])
    return text_table("What could not be measured, and why.", ("Measurement", "Phase", "Where", "Why"), rows)


def _where(members: Sequence[Measurement]) -> str:
    """Name locations and qualifiers, each once: ``R0, R2 (image, loading; image, unloading)``."""
    places = ", ".join(dict.fromkeys(m.location for m in members if m.location))
    kinds = "; ".join(dict.fromkeys(m.qualifier for m in members if m.qualifier))
    if places and kinds:
        return f"{places} ({kinds})"
    return places or kinds or "–"
