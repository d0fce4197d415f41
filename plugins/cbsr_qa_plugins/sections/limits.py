"""Every limit with its value, margin and outcome, and every other measurement."""

from collections.abc import Sequence

from cbsr_qa.domain.load_events import RecordingResult
from cbsr_qa.domain.measurement import Measurement
from cbsr_qa.domain.outcome import SEVERITY, Outcome
from cbsr_qa.domain.report import Block, Cell, Paragraph, RunResult, Section, Table
from cbsr_qa.report.numbers import plain, plural, quantity
from cbsr_qa.report.select import mean_deviation
from cbsr_qa.report.tables import limit_text, margin_text, text_table, unit_column, value_cell


class Limits:
    """Section that lists everything that was measured, whoever's plugin measured it."""

    def render(self, result: RunResult | RecordingResult) -> Section | None:
        """Return the section; None for a recording, or where nothing was measured."""
        if not isinstance(result, RunResult) or not result.measurements:
            return None
        judged = [m for m in result.measurements if m.limit is not None]
        others = [m for m in result.measurements if m.limit is None]
        blocks: list[Block] = [Paragraph(_in_words(judged))]
        if judged:
            blocks.append(_judged(judged))
        determined = [m for m in others if m.value is not None]
        if determined:
            blocks.append(_others(determined))
        refused = [m for m in others if m.value is None]
        if refused:
            blocks.append(_refused(refused))
        return Section("Limits and measurements", tuple(blocks))


def _in_words(judged: Sequence[Measurement]) -> str:
    if not judged:
        return "The recipe sets no limit on anything that was measured."
    counts = [(outcome, sum(m.outcome is outcome for m in judged)) for outcome in reversed(SEVERITY)]
    words = ", ".join(f"{count} {outcome.value}" for outcome, count in counts if count)
    return f"{plural(len(judged), 'limit')} judged: {words}. The worst are listed first."


def _judged(judged: Sequence[Measurement]) -> Table:
    # Stable: measurements of equal outcome stay in the order of the recipe.
    order = sorted(judged, key=lambda m: SEVERITY.index(m.outcome))
    rows: list[list[str | Cell]] = []
    for m in order:
        assert m.limit is not None
        signs = {Outcome.PASS: "✓ ", Outcome.FAIL: "✗ ", Outcome.MARGINAL: "≈ ", Outcome.NOT_MEASURED: "? "}
        outcome = Cell(f"{signs.get(m.outcome, '')}{m.outcome.value}", m.outcome)
        value = Cell(value_cell(m, unit=True).text)
        why = m.how if m.value is None else ""
        name = f"{m.label}: {why}" if why else m.label
        rows.append([name, m.phase or "whole run", value, limit_text(m.limit), margin_text(m), outcome])
    columns = ("Measurement", "Phase", "Value", "Limit", "Margin", "Outcome")
    return text_table("Limits. Margin: distance from the nearer bound, negative outside.", columns, rows, (2, 3, 4))


def _others(measurements: Sequence[Measurement]) -> Table:
    groups: dict[tuple[str, str, str, str], list[Measurement]] = {}
    for m in measurements:
        groups.setdefault((m.name, m.qualifier, m.phase, m.unit), []).append(m)
    rows = [_group_row(key, members) for key, members in groups.items()]
    columns = ("Measurement", "Phase", "Number", "Value, or mean ± standard deviation", "Lowest", "Highest")
    caption = "Everything else that was measured; no limit was set for it. Several values are summarised in one row."
    return text_table(caption, columns, rows, (2, 3, 4, 5))


def _group_row(key: tuple[str, str, str, str], members: Sequence[Measurement]) -> list[str]:
    name, qualifier, phase, unit = key
    words = name.replace("_", " ")
    title = f"{words} ({qualifier})" if qualifier else words
    if len(members) == 1:
        only = members[0]
        assert only.value is not None
        value = quantity(only.value, unit, only.uncertainty)
        return [only.label, phase or "whole run", "1", value, "", ""]
    values = [m.value for m in members if m.value is not None]
    found = mean_deviation(values)
    assert found is not None
    mean = quantity(found[0], unit, found[1]) if found[1] else quantity(found[0], unit)
    ends = [plain(end, unit) for end in (min(values), max(values))]
    return [
        unit_column(title, unit) if unit not in ("Ω", "ohm", "V") else title,
        phase or "whole run",
        str(len(members)),
        mean,
        *ends,
    ]


def _refused(measurements: Sequence[Measurement]) -> Table:
    groups: dict[tuple[str, str, str], list[str]] = {}
    for m in measurements:
        groups.setdefault((m.name, m.phase, m.how), []).append(", ".join(p for p in (m.location, m.qualifier) if p))
    rows = [
        [name.replace("_", " "), phase or "whole run", "; ".join(dict.fromkeys(w for w in where if w)) or "–", how]
        for (name, phase, how), where in groups.items()
    ]
    return text_table("What could not be measured, and why.", ("Measurement", "Phase", "Where", "Why"), rows)
