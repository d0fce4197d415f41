"""Lists of runs and sensors, with counts, yields and reasons for failure, for a terminal; and as CSV."""

from collections.abc import Iterator, Sequence
from dataclasses import fields
from datetime import UTC, datetime
from typing import Any, Final

from cbsr_qa.app.shift.lists import Altered, RunEntry, RunList, SensorEntry, SensorList
from cbsr_qa.app.shift.summary import ShiftSummary, Tally
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.listed import ALTERED
from cbsr_qa.domain.results.report import Banner, Block, Cell, CommandOutcome, Page, Section, Table
from cbsr_qa.domain.run.run import UNCHAINED
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.report.tables import plural, text_table
from cbsr_qa.stats.process_capability import Yield
from cbsr_qa.system.clock import name_zones, write_local_time
from cbsr_qa.system.files import csv_text

#: Rows of a table in a terminal; JSON and CSV have all.
MOST_SHOWN: Final = 200

# Sentences, in reading order.
_NOTHING: Final = "nothing was tested"
_COUNTS: Final = "{passed} passed, {failed} failed{others}"
_YIELD: Final = "{passed} of {count}, {share:.0f} % ({low:.0f} to {high:.0f} %)"
_CUT: Final = "The latest {shown} of {count}; --csv FILE and --json have all."
_RUNS: Final = "Oldest first; times are {zone}."
_SENSORS: Final = "Each with the verdict of its last decided run, the last tested at the end; times are {zone}."
_NO_RESULT: Final = "no result yet: cbsr-qa run --resume {run} computes it"
_REASONS: Final = "Sensors and runs that failed a limit; one run may fail several."
_CODES: Final = "Sensors and runs with a failure code of their recipe; one run may have several."
_PARTS: Final = "Yield: sensors that passed in their last decided run. First pass: in their first finished run."

#: Counts of a tally besides passed and failed, and their words.
_OTHERS: Final = (
    ("not_measured", "not measured"),
    ("not_judged", "not judged"),
    ("no_result", "without a result"),
    ("not_finished", "not finished"),
    ("altered", "altered"),
)


def runs_outcome(found: RunList) -> CommandOutcome[RunList]:
    """Lay out a list of runs."""
    rows = [_run_row(run) for run in found.runs[-MOST_SHOWN:]]
    columns = ("began", "sensor", "try", "batch", "station", "recipe", "verdict", "reason")
    caption = _RUNS.format(zone=name_zones([run.started_at for run in found.runs]))
    table = text_table(_cut(caption, len(found.runs)), columns, rows, (2,))
    return _outcome(found, "Runs", plural(len(found.runs), "run"), table)


def sensors_outcome(found: SensorList) -> CommandOutcome[SensorList]:
    """Lay out a list of sensors."""
    rows = [_sensor_row(sensor) for sensor in found.sensors[-MOST_SHOWN:]]
    columns = ("last run", "sensor", "batch", "recipe", "runs", "station", "verdict", "reason")
    caption = _SENSORS.format(zone=name_zones([sensor.last for sensor in found.sensors]))
    table = text_table(_cut(caption, len(found.sensors)), columns, rows, (4,))
    return _outcome(found, "Sensors", plural(len({sensor.serial for sensor in found.sensors}), "sensor"), table)


def runs_csv(found: RunList) -> str:
    """Return runs as CSV (RFC 4180, UTF-8): a header, then a line a run; the columns are the keys of ``--json``."""
    return _csv(RunEntry, found.runs)


def sensors_csv(found: SensorList) -> str:
    """Return sensors as CSV, as :func:`runs_csv` does runs."""
    return _csv(SensorEntry, found.sensors)


def counts_words(tally: Tally) -> str:
    """Return how many runs passed and failed, and what became of the others if there are any."""
    other_counts = "".join(f", {getattr(tally, key)} {label}" for key, label in _OTHERS if getattr(tally, key))
    return _COUNTS.format(passed=tally.passed, failed=tally.failed, others=other_counts)


def yield_words(found: Yield | None) -> str:
    """Return a yield in words, with its 95 % interval; a dash if nothing was decided."""
    if found is None:
        return "–"
    low, high = 100 * found.wilson.low, 100 * found.wilson.high
    return _YIELD.format(passed=found.passed, count=found.count, share=100 * found.value, low=low, high=high)


def _outcome(found: Any, kind: str, headline: str, table: Table) -> CommandOutcome[Any]:
    summary: ShiftSummary = found.summary
    total = summary.total
    banner = Banner("plain", "–", headline, counts_words(total) if total.runs else _NOTHING)
    facts = [("Yield", yield_words(total.test_yield)), ("First pass", yield_words(total.first_pass_yield))]
    facts += [("Overridden", plural(total.overridden, "verdict"))] if total.overridden else []
    page = Page(kind, "", banner, tuple(facts) if total.decided else (), remarks=found.notes)
    sections = (Section(kind, (table,)), *_summary(summary)) if table.rows else ()
    return CommandOutcome(found, page, sections, exit_code(total.altered))


def exit_code(altered: int) -> int:
    """Return the exit code of a list or table with so many altered runs: 1 with any, as of ``cbsr-qa db check``."""
    return 1 if altered else 0


def _summary(summary: ShiftSummary) -> Iterator[Section]:
    if summary.reasons:
        limits = [(reason.words, str(reason.sensors), str(reason.runs)) for reason in summary.reasons]
        yield Section("Reasons for failure", (text_table(_REASONS, ("limit", "sensors", "runs"), limits, (1, 2)),))
    if summary.codes:
        codes = [(c.code, c.text, c.disposition or "–", str(c.sensors), str(c.runs)) for c in summary.codes]
        header = ("code", "failure", "disposition", "sensors", "runs")
        yield Section("Failure codes", (text_table(_CODES, header, codes, (3, 4)),))
    blocks: list[Block] = []
    for kind, parts in (("station", summary.stations), ("recipe", summary.recipes)):
        rows = [
            (
                part.name,
                *map(str, (part.runs, part.passed, part.failed)),
                yield_words(part.test_yield),
                yield_words(part.first_pass_yield),
            )
            for part in parts
        ]
        if len(rows) > 1:
            columns = (kind, "runs", "passed", "failed", "yield", "first pass")
            blocks.append(text_table(_PARTS, columns, rows, (1, 2, 3)))
    if blocks:
        yield Section("Stations and recipes", tuple(blocks))


def _cut(caption: str, count: int) -> str:
    return caption if count <= MOST_SHOWN else f"{_CUT.format(shown=MOST_SHOWN, count=count)} {caption}"


def _run_row(run: RunEntry) -> tuple[str | Cell, ...]:
    reason = _why(run)
    if run.verdict is None:
        reason = _NO_RESULT.format(run=run.run) if run.end is EndReason.FINISHED else ""
    return (
        write_local_time(run.started_at, zone=False),
        run.serial,
        str(run.number),
        run.batch or "–",
        run.station,
        run.recipe,
        _verdict(run.verdict, run.end, run.chain),
        reason,
    )


def _sensor_row(sensor: SensorEntry) -> tuple[str | Cell, ...]:
    return (
        write_local_time(sensor.last, zone=False),
        sensor.serial,
        sensor.batch or "–",
        sensor.recipe,
        str(sensor.runs),
        sensor.station,
        _verdict(sensor.verdict, sensor.end, sensor.chain),
        _why(sensor),
    )


def _why(entry: RunEntry | SensorEntry) -> str:
    """Return the reason of a verdict in words: of its override, if there is one."""
    if entry.overridden_by is None:
        return entry.reason
    return f"overridden by {entry.overridden_by}: {entry.overridden_why}"


def _verdict(verdict: Outcome | Altered | None, end: EndReason, chain: str) -> Cell:
    if verdict == ALTERED:
        return Cell(ALTERED, Outcome.NOT_MEASURED)
    unsaid = f", {chain}" if chain == UNCHAINED.label else ""  # nothing would tell if it was altered
    if verdict is not None:
        return Cell(f"{verdict}{unsaid}", verdict)
    end_words = "no result" if end is EndReason.FINISHED else str(end)
    return Cell(f"{end_words}{unsaid}", Outcome.NOT_MEASURED)


def _csv(kind: type, entries: Sequence[Any]) -> str:
    names = [field.name for field in fields(kind)]
    rows = ([table_cell(getattr(entry, name)) for name in names] for entry in entries)
    return csv_text([names, *rows], line_end="\r\n")


def table_cell(value: Any) -> str | float | None:
    """Return a value as a cell of a CSV file: times in UTC (ISO 8601), ``true`` and ``false``."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return "; ".join(map(str, value))
    if isinstance(value, datetime):
        return value.astimezone(UTC).isoformat()
    cell: str | float | None = value
    return cell
