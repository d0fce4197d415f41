"""The verdict of each location, as signs and in words."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from cbsr_qa.domain.plan.limits import SEVERITY, Outcome, worst
from cbsr_qa.domain.results.measurement import Measurement, metric_words, relative_margin
from cbsr_qa.domain.results.observation import RunObservation
from cbsr_qa.report.tables import limit_text, plural, value_cell

#: Signs before an outcome, so that it reads without colour.
SIGNS: Final = {Outcome.PASS: "✓", Outcome.FAIL: "✗", Outcome.MARGINAL: "≈", Outcome.NOT_MEASURED: "?"}


#: Locations that are named in words; of more the worst ones are.
_MOST_NAMED: Final = 6


def outcome_counts(outcomes: Sequence[Outcome]) -> str:
    """Count outcomes in words, the best first: ``7 pass, 1 marginal, 1 fail``."""
    counts = Counter(outcomes)
    return ", ".join(f"{counts[outcome]} {outcome.value}" for outcome in reversed(SEVERITY) if counts[outcome])


@dataclass(frozen=True, slots=True)
class LocationVerdict:
    """What was judged at one place of a phase, over all its trials and strains.

    Parameters
    ----------
    deciding : measurement of the worst outcome that is closest to (or furthest beyond) its limit.
    judged : number of measurements that were judged.
    """

    phase: str
    label: str
    x_mm: float
    y_mm: float
    outcome: Outcome
    deciding: Measurement
    judged: int


def location_verdicts(run: RunObservation, judged: Sequence[Measurement]) -> tuple[LocationVerdict, ...]:
    """Return the verdicts of all places where a single load was judged, in the order they were pressed."""
    load_by_key = {(load.phase, load.record.index): load.record.load for load in run.loads}
    groups: dict[tuple[str, str, float, float], list[Measurement]] = {}
    for m in judged:
        if m.load is not None and (place := load_by_key.get((m.phase, m.load))) is not None:
            groups.setdefault((m.phase, place.label, place.x_mm, place.y_mm), []).append(m)
    order = {phase.name: number for number, phase in enumerate(run.record.phases)}
    verdicts = []
    for (phase, label, x_mm, y_mm), members in groups.items():
        outcome = worst(m.outcome for m in members)
        deciding = min((m for m in members if m.outcome is outcome), key=relative_margin)
        verdicts.append(LocationVerdict(phase, label, x_mm, y_mm, outcome, deciding, len(members)))
    return tuple(sorted(verdicts, key=lambda verdict: order.get(verdict.phase, 0)))


def verdicts_in_words(verdicts: Sequence[LocationVerdict]) -> str:
    """Say which locations did not pass, and what decided; the worst first."""
    not_passed = [verdict for verdict in verdicts if verdict.outcome is not Outcome.PASS]
    if not not_passed:
        return f"By location: all {len(verdicts)} pass." if len(verdicts) > 1 else "By location: the only one passes."
    not_passed.sort(key=lambda verdict: (SEVERITY.index(verdict.outcome), relative_margin(verdict.deciding)))
    sentence = "; ".join(_describe_deciding(verdict) for verdict in not_passed[:_MOST_NAMED])
    unnamed_count = len(not_passed) - _MOST_NAMED
    sentence += f"; and {unnamed_count} more" if unnamed_count > 0 else ""
    passed = len(verdicts) - len(not_passed)
    passed_words = f" The other {passed} pass." if passed > 1 else " The other one passes." if passed else ""
    return f"By location, {plural(len(not_passed), 'does', 'do')} not simply pass: {sentence}.{passed_words}"


def _describe_deciding(verdict: LocationVerdict) -> str:
    m = verdict.deciding
    assert m.limit is not None
    name = metric_words(m.name)
    if m.value is None:
        return f"{verdict.label} ({verdict.phase}) {verdict.outcome}, {name}: {m.how}"
    value, limit = value_cell(m, unit=True).text, limit_text(m.limit)
    return f"{verdict.label} ({verdict.phase}) {verdict.outcome}, {name} {value} (limit {limit})"
