"""The verdict of each location: the worst of all that was judged there."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from cbsr_qa.domain.measurement import Measurement, relative_margin
from cbsr_qa.domain.observation import RunObservation
from cbsr_qa.domain.outcome import SEVERITY, Outcome, worst
from cbsr_qa.report.numbers import plural
from cbsr_qa.report.tables import limit_text, value_cell

#: What stands before an outcome, so that it reads without colour.
SIGNS: Final = {Outcome.PASS: "✓", Outcome.FAIL: "✗", Outcome.MARGINAL: "≈", Outcome.NOT_MEASURED: "?"}
#: Locations that are named in words; of more the worst ones are.
_MOST_NAMED: Final = 6


@dataclass(frozen=True, slots=True)
class LocationVerdict:
    """What was judged at one place of a phase, over all its trials and strains.

    Parameters
    ----------
    deciding : of the worst outcome, the measurement closest to (or furthest beyond) its limit.
    judged : how many measurements.
    """

    phase: str
    label: str
    x_mm: float
    y_mm: float
    outcome: Outcome
    deciding: Measurement
    judged: int


def location_verdicts(run: RunObservation, judged: Sequence[Measurement]) -> tuple[LocationVerdict, ...]:
    """Return the verdicts of all places where a single load was judged, in the order they were pressed.

    Parameters
    ----------
    judged : measurements with a limit; those that are not about one load are left out.
    """
    at = {(load.phase, load.record.index): load.record.load for load in run.loads}
    groups: dict[tuple[str, str, float, float], list[Measurement]] = {}
    for m in judged:
        if m.load is not None and (place := at.get((m.phase, m.load))) is not None:
            groups.setdefault((m.phase, place.label, place.x_mm, place.y_mm), []).append(m)
    order = {phase.name: number for number, phase in enumerate(run.record.phases)}
    found = []
    for (phase, label, x_mm, y_mm), members in groups.items():
        outcome = worst(m.outcome for m in members)
        deciding = min((m for m in members if m.outcome is outcome), key=relative_margin)
        found.append(LocationVerdict(phase, label, x_mm, y_mm, outcome, deciding, len(members)))
    return tuple(sorted(found, key=lambda one: order.get(one.phase, 0)))


def verdicts_in_words(verdicts: Sequence[LocationVerdict]) -> str:
    """Say which locations did not pass, and what decided; the worst first."""
    kept = [one for one in verdicts if one.outcome is not Outcome.PASS]
    if not kept:
        return f"By location: all {len(verdicts)} pass." if len(verdicts) > 1 else "By location: the only one passes."
    kept.sort(key=lambda one: (SEVERITY.index(one.outcome), relative_margin(one.deciding)))
    named = "; ".join(_named(one) for one in kept[:_MOST_NAMED])
    more = len(kept) - _MOST_NAMED
    named += f"; and {more} more" if more > 0 else ""
    passed = len(verdicts) - len(kept)
    rest = f" The other {passed} pass." if passed > 1 else " The other one passes." if passed else ""
    return f"By location, {plural(len(kept), 'does', 'do')} not simply pass: {named}.{rest}"


def _named(one: LocationVerdict) -> str:
    m = one.deciding
    assert m.limit is not None
    name = m.name.replace("_", " ").replace("snr", "SNR")
    if m.value is None:
        return f"{one.label} ({one.phase}) {one.outcome}, {name}: {m.how}"
    value, limit = value_cell(m, unit=True).text, limit_text(m.limit)
    return f"{one.label} ({one.phase}) {one.outcome}, {name} {value} (limit {limit})"
