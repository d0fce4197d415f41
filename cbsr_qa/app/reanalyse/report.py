"""The outcome of a re-analysis: which verdicts flip, which values change, and which runs could not be analysed."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from cbsr_qa.app.reanalyse.changes import Flip, NamedRun, ValueChange
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.fleet import MetricKey
from cbsr_qa.domain.results.report import Banner, Cell, CommandOutcome, Page, Section
from cbsr_qa.report.tables import duration, number, plural, text_table, unit_shown

#: Rows of a table; JSON has all.
MOST_SHOWN: Final = 200

# Sentences, in reading order.
_COUNTS: Final = (
    "{computed} computed, {judged}{reused} stored already; {unchanged} equal the valid analysis in every value"
)
_JUDGED: Final = "{judged} judged by other limits without being imaged, "
_FREE: Final = "nothing was computed: {reused} of {reused} results were stored already"
_TRIAL: Final = "nothing changes yet: --adopt --by NAME --why TEXT makes these results the valid analyses"
_ADOPTED: Final = (
    "{adopted} adopted: they are the valid analyses now; earlier ones stay, and cbsr-qa db changes lists this"
)
_WITHDRAW: Final = "take calibration {calibration} of {serial} out of use: its run no longer passes"
_NO_CALIBRATION: Final = (
    "{count} that did not pass before would pass now; adopting issues no calibration: test the sensor again for one"
)
_FLIPS: Final = "Verdicts that differ from the valid ones, the worst first; days are UTC."
_VALUES: Final = "New − valid value of each measurement, over all runs; what did not change is left out."
_NOT_ANALYSED: Final = "Runs without a new result: nothing of them is stored, and their verdicts stay."
_OTHER_PLAN: Final = "Runs that were measured by another plan than the recipe's phases; they were not analysed."
_OVERRIDDEN: Final = "Runs that were not adopted: a person decided against their verdict. Judge each one by hand."
_WARNINGS: Final = "Warnings that the valid analyses do not have."
_CUT: Final = "The first {shown} of {count}; --json has all. "


@dataclass(frozen=True, slots=True)
class Reanalysed:
    """Changes by a re-analysis.

    Parameters
    ----------
    recipe, recipe_sha256 : recipe of all runs, and its digest; None where each run's own was used.
    selected, computed, judged, reused, adopted : runs that were selected, analysed now, only judged by other limits
        now, had a stored result, and whose result was made the valid analysis now.
    unchanged : runs with the verdict and all values of their valid analysis.
    values : every measurement with its changes.
    flips : verdicts that differ, those that got worse first.
    not_analysed : runs without a result, with the reason; nothing of them is stored.
    other_plan : runs whose phases are not the recipe's, with the first that differs; they were not analysed.
    left_overridden : runs that were not adopted, as a person decided against their valid verdict.
    new_warnings : warnings that the valid analyses do not have, and of how many runs they are.
    workers : place where the results were computed, in words.
    elapsed_s, runs_per_s : duration and rate of computing; the rate is None if nothing was computed.
    peak_worker_mb : largest resident memory of a worker [MB]; None if unknown.
    """

    recipe: str | None
    recipe_sha256: str | None
    software: tuple[tuple[str, str], ...]
    selected: int
    computed: int
    judged: int
    reused: int
    adopted: int
    unchanged: int
    values: tuple[ValueChange, ...]
    flips: tuple[Flip, ...]
    not_analysed: tuple[NamedRun, ...]
    other_plan: tuple[NamedRun, ...]
    left_overridden: tuple[NamedRun, ...]
    new_warnings: Mapping[str, int]
    workers: str
    elapsed_s: float
    runs_per_s: float | None
    peak_worker_mb: float | None


def reanalysis_outcome(done: Reanalysed) -> CommandOutcome[Reanalysed]:
    """Lay out a re-analysis; exit code 3 if no run has a result."""
    results = done.computed + done.judged + done.reused
    no_longer_passed = [flip for flip in done.flips if flip.was in _PASSED and flip.now not in _PASSED]
    headline = f"{plural(results, 'run')} analysed again, {plural(len(done.flips), 'verdict')} differ"
    if len(done.flips) == 1:
        headline += "s"
    counts_template = _COUNTS if done.computed or done.judged else _FREE
    judged = _JUDGED.format(judged=done.judged) if done.judged else ""
    reason = counts_template.format(
        computed=done.computed, judged=judged, reused=done.reused, unchanged=done.unchanged
    )
    banner = Banner("marginal" if done.flips else "pass", "≠" if done.flips else "✓", headline, reason)
    if not results:
        banner = Banner("not-measured", "?", "no run could be analysed again", "the reasons are below")
    page = Page(
        "Re-analysis",
        done.recipe or "",
        banner,
        tuple(_facts(done)),
        warnings=tuple(_warnings(done, no_longer_passed)),
    )
    return CommandOutcome(done, page, tuple(_sections(done)), exit_code=0 if results else 3)


_PASSED: Final = (Outcome.PASS, Outcome.MARGINAL)


def _facts(done: Reanalysed) -> Iterator[tuple[str, str]]:
    digest = "" if done.recipe_sha256 is None else f" ({done.recipe_sha256[:12]})"
    yield "Recipe", "of each run itself" if done.recipe is None else f"{done.recipe}{digest}"
    yield "Software", f"cbsr-qa {dict(done.software)['cbsr-qa']}"
    other_groups = ((done.not_analysed, "could not be analysed"), (done.other_plan, "of another plan"))
    other_counts = "".join(f", {len(runs)} {label}" for runs, label in other_groups if runs)
    yield "Runs", f"{done.selected} selected{other_counts}"
    if done.runs_per_s is not None:
        yield "Computed", f"in {duration(done.elapsed_s)} by {done.workers}: {number(done.runs_per_s)} runs/s"
    if done.peak_worker_mb is not None:
        yield "Memory", f"{done.peak_worker_mb:.0f} MB at most in a worker"
    if done.computed or done.judged or done.reused:
        yield "Verdicts", _ADOPTED.format(adopted=plural(done.adopted, "result")) if done.adopted else _TRIAL


def _warnings(done: Reanalysed, worse: Sequence[Flip]) -> Iterator[str]:
    if not done.adopted:
        return
    for flip in worse:
        if flip.calibration is not None and flip.run not in {run.run for run in done.left_overridden}:
            yield _WITHDRAW.format(calibration=flip.calibration, serial=flip.serial)
    now_passed_count = sum(flip.now in _PASSED and flip.was not in _PASSED for flip in done.flips)
    if now_passed_count:
        yield _NO_CALIBRATION.format(count=plural(now_passed_count, "run"))


def _sections(done: Reanalysed) -> Iterator[Section]:
    if done.flips:
        rows = [_flip_row(flip) for flip in done.flips[:MOST_SHOWN]]
        columns = ("sensor", "began", "station", "valid", "new", "reason", "run")
        yield Section("Verdicts", (text_table(_cut(_FLIPS, len(done.flips)), columns, rows),))
    changed_values = [value for value in done.values if value.changed or value.gained or value.lost]
    if changed_values:
        values = [_value_row(value) for value in changed_values[:MOST_SHOWN]]
        names = ("measurement", "unit", "values", "changed", "median", "largest", "of", "gained", "lost")
        yield Section("Values", (text_table(_cut(_VALUES, len(changed_values)), names, values, (2, 3, 4, 5, 7, 8)),))
    for title, caption, runs in (
        ("Not analysed", _NOT_ANALYSED, done.not_analysed),
        ("Another plan", _OTHER_PLAN, done.other_plan),
        ("Not adopted", _OVERRIDDEN, done.left_overridden),
    ):
        if runs:
            named = [(run.serial, f"{run.started_at:%Y-%m-%d}", run.why, run.run) for run in runs[:MOST_SHOWN]]
            headings = ("sensor", "began", "reason", "run")
            yield Section(title, (text_table(_cut(caption, len(runs)), headings, named),))
    if done.new_warnings:
        counts = [(str(count), warning) for warning, count in list(done.new_warnings.items())[:MOST_SHOWN]]
        caption = _cut(_WARNINGS, len(done.new_warnings))
        yield Section("New warnings", (text_table(caption, ("runs", "warning"), counts, (0,)),))


def _flip_row(flip: Flip) -> tuple[str | Cell, ...]:
    cell_before = Cell("none") if flip.was is None else Cell(str(flip.was), flip.was)
    if flip.overridden_to is not None:
        cell_before = Cell(f"{flip.was}, overridden to {flip.overridden_to}", flip.overridden_to)
    when = f"{flip.started_at:%Y-%m-%d}"
    return flip.serial, when, flip.station, cell_before, Cell(str(flip.now), flip.now), flip.reason, flip.run


def _value_row(value: ValueChange) -> tuple[str, ...]:
    median = "–" if value.median is None else number(value.median)
    largest = "–" if value.largest is None else number(value.largest)
    count_cells = (str(value.gained or ""), str(value.lost or ""))
    label = MetricKey(value.name, value.phase, value.qualifier).title
    return (
        label,
        unit_shown(value.unit),
        str(value.values),
        str(value.changed),
        median,
        largest,
        value.serial,
        *count_cells,
    )


def _cut(caption: str, count: int) -> str:
    return caption if count <= MOST_SHOWN else _CUT.format(shown=MOST_SHOWN, count=count) + caption
