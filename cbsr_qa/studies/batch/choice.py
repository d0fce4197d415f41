"""Runs that a batch's model rests on: the latest good run of each sensor, and why others are left out."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.fleet import RunLine, RunSelection
from cbsr_qa.domain.run.run import RunRecord
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.report.tables import list_names, plural
from cbsr_qa.store.repository import Repository
from cbsr_qa.studies.selection import check_names
from cbsr_qa.system.words import echo

#: Fewest sensors that a model is learned from.
FEWEST: Final = 5
_PASSED: Final = (Outcome.PASS, Outcome.MARGINAL)
_SUPERSEDED: Final = "a later run of the sensor counts"


@dataclass(frozen=True, slots=True)
class BatchChoice:
    """Which runs are meant.

    Parameters
    ----------
    runs : the batch, and further criteria.
    sensor_type, material : names; None for the only one.
    without : serial numbers to leave out.
    """

    runs: RunSelection
    sensor_type: str | None = None
    material: str | None = None
    without: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class LeftOutRun:
    """A run of the batch that the model does not rest on, and why."""

    serial: str
    run: str
    why: str


def choose_runs(
    store: Repository, choice: BatchChoice, count: Callable[[int, int], None]
) -> tuple[tuple[RunRecord, ...], tuple[LeftOutRun, ...]]:
    """Load the run of each sensor that counts, in the order they were made in.

    Parameters
    ----------
    count : called with the number of runs loaded, and of all.

    Raises
    ------
    RefusedError
        If a name is unknown, the runs are of several sensor types, materials or heads, or fewer than five sensors
        remain; with the reasons for runs that were left out.
    """
    selected = RunSelection(serials=choice.without)
    check_names(store, selected)
    lines = store.fleet.read_lines(choice.runs)
    if not lines:
        check_names(store, choice.runs)
        raise RefusedError("no stored run fits all of these choices together")
    left_out: list[LeftOutRun] = []
    of_kind: list[RunLine] = []
    for line in lines:
        why = _describe_unfit(line, choice) or _describe_other_kind(store, line, choice)
        if why:
            left_out.append(LeftOutRun(line.serial, line.run, why))
        else:
            of_kind.append(line)
    _refuse_mixture(store, of_kind)
    records = []
    latest = {line.serial: line.run for line in of_kind}
    for number, line in enumerate(of_kind):
        why = _SUPERSEDED
        if latest[line.serial] == line.run:
            record = store.runs.load(line.run)
            why = "" if record.chain.chained else "it is not under a chain: nobody would notice if it were changed"
            if not why:
                records.append(record)
        if why:
            left_out.append(LeftOutRun(line.serial, line.run, why))
        count(number + 1, len(of_kind))
    refuse_few(len(records), left_out, choice)
    _refuse_other_settings(records)
    return tuple(records), tuple(left_out)


def _describe_unfit(line: RunLine, choice: BatchChoice) -> str:
    """Say why a run cannot count; empty if it can."""
    reasons = (
        (line.serial in choice.without, "left out by --without"),
        (bool(line.altered), f"it was altered: {line.altered}"),
        (line.of_check, "it is a golden sensor's, made to check its station"),
        (line.end is not EndReason.FINISHED, f"it was {line.end}"),
        (line.verdict is None, "it was never analysed"),
        (line.verdict not in _PASSED, f"its verdict is {line.verdict}"),
    )
    return next((why for applies, why in reasons if applies), "")


def _describe_other_kind(store: Repository, line: RunLine, choice: BatchChoice) -> str:
    if choice.material is not None and line.material != choice.material:
        return f"it is of material {line.material}"
    sensor_type = store.runs.read_identity(line.run).sensor.sensor_type
    if choice.sensor_type is not None and sensor_type != choice.sensor_type:
        return f"it is of sensor type {sensor_type}"
    return ""


def _refuse_mixture(store: Repository, lines: Sequence[RunLine]) -> None:
    types = Counter(store.runs.read_identity(line.run).sensor.sensor_type for line in lines)
    materials = Counter(line.material for line in lines)
    for noun, option, counts in (("sensor types", "--sensor-type", types), ("materials", "--material", materials)):
        if len(counts) > 1:
            names = ", ".join(f"{echo(name, 64)} ({plural(count, 'run')})" for name, count in sorted(counts.items()))
            raise RefusedError(
                f"the runs are of {len(counts)} {noun}: {names}",
                remedy=f"sensors of different {noun} teach nothing about each other: name one by {option}",
            )


def refuse_few(sensors: int, left_out: Sequence[LeftOutRun], choice: BatchChoice) -> None:
    """Refuse a batch of fewer sensors than a model needs, with the reasons for those that were left out."""
    if sensors >= FEWEST:
        return
    others = f"; left out: {list_names(tuple(_words(left_out)))}" if left_out else ""
    batch = "" if choice.runs.batch is None else f" of batch {echo(choice.runs.batch, 64)}"
    raise RefusedError(
        f"{plural(sensors, 'sensor')}{batch} can be learned from; {FEWEST} are needed{others}",
        remedy="measure more sensors, or choose other runs",
    )


def _refuse_other_settings(records: Sequence[RunRecord]) -> None:
    """Refuse sensor types and materials of one name with other numbers, and other heads: their responses differ."""
    first = records[0]
    for record in records[1:]:
        differing = [
            noun
            for noun, alike in (
                ("electrodes or outline of the sensor type", _shape(record) == _shape(first)),
                ("line of the material", record.material.against_stress == first.material.against_stress),
                ("head", record.indenter == first.indenter),
            )
            if not alike
        ]
        if differing:
            raise RefusedError(
                f"{' and '.join(differing)} of run {record.identity.run} of sensor {record.identity.sensor.serial} "
                f"differ from those of run {first.identity.run}, the first",
                remedy="choose runs that were measured alike, by --recipe, --since, --until or --without",
            )


def _shape(record: RunRecord) -> tuple[object, ...]:
    sensor_type = record.sensor_type
    return sensor_type.outline, sensor_type.electrodes, sensor_type.thickness_mm


def _words(left_out: Sequence[LeftOutRun]) -> Iterator[str]:
    yield from (f"{run.serial} ({run.why})" for run in left_out if run.why != _SUPERSEDED)
