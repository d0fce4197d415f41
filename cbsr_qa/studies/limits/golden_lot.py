"""Golden lots: stored runs of sensors known to be good, chosen by the user and checked to belong together."""

import hashlib
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

from pydantic import Field, InstanceOf

from cbsr_qa.config.merging import canonical_json
from cbsr_qa.config.serials import validate_serial
from cbsr_qa.domain.errors import RefusedError, StoreError
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.fleet import RunLine, RunSelection
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.report.tables import list_names
from cbsr_qa.store.repository import Repository
from cbsr_qa.store.results.analyses import StoredAnalysis
from cbsr_qa.studies.selection import check_names, measuring_digest, software_words
from cbsr_qa.system.foreign import read_foreign

_GOOD = (Outcome.PASS, Outcome.MARGINAL, Outcome.NOT_JUDGED)


@dataclass(frozen=True, slots=True)
class LotChoice:
    """Selection of the golden lot from stored runs.

    Parameters
    ----------
    include_failed : include runs that failed, or with missing measurements.
    allow_mixed : accept several recipes or software versions.
    """

    runs: RunSelection
    without: tuple[str, ...] = ()
    include_failed: bool = False
    allow_mixed: bool = False

    def words(self) -> str:
        """Describe the choice for a reader."""
        selection = self.runs
        phrases = [f"batch {selection.batch}"] if selection.batch is not None else []
        phrases += [f"recipe {selection.recipe}"] if selection.recipe is not None else []
        phrases += [f"since {selection.since}"] if selection.since else []
        phrases += [f"until {selection.until}"] if selection.until else []
        return ", ".join([*phrases, *(["named sensors"] if selection.serials else [])])


@dataclass(frozen=True, slots=True)
class LotRun:
    """One run of the lot with its latest analysis."""

    line: RunLine
    analysis: StoredAnalysis


@dataclass(frozen=True, slots=True, eq=False)
class Lot:
    """A golden lot.

    Parameters
    ----------
    sensors : serial → its runs, oldest first; sensors by serial.
    software : (distribution, version) of the first run's analysis.
    not_good, mixed : accepted runs that are not good, or differ; in words.
    analysed : sensor → its runs with their analyses.
    """

    chosen: str
    sensors: dict[str, tuple[str, ...]]
    stations: tuple[str, ...]
    software: tuple[tuple[str, str], ...]
    left_out: tuple[str, ...]
    not_good: tuple[str, ...]
    mixed: tuple[str, ...]
    simulated: tuple[str, ...]
    analysed: Annotated[InstanceOf[dict[str, tuple[LotRun, ...]]], Field(exclude=True)]

    @property
    def runs(self) -> tuple[LotRun, ...]:
        return tuple(run for runs in self.analysed.values() for run in runs)

    def data_sha256(self) -> str:
        """SHA-256 of every measurement of the lot, independent of order."""
        rows = []
        for run in self.runs:
            for m in run.analysis.measurements:
                key = [m.phase, m.location, m.trial, m.load, m.qualifier]
                identity = [run.line.serial, run.line.run, m.name, m.unit, *key]
                rows.append(canonical_json([*identity, m.value, m.uncertainty, str(m.bound)]))
        return hashlib.sha256("\n".join(sorted(rows)).encode()).hexdigest()


#: Size above that of any list of serial numbers [bytes].
_MAX_LIST_BYTES: Final = 2**24


def read_serials(path: Path) -> tuple[str, ...]:
    """Read serial numbers, one per line; ``#`` begins a comment.

    RefusedError if the file cannot be read, has none, or a line is not a serial number (with its line number).
    """
    try:
        lines = read_foreign(path, _MAX_LIST_BYTES).decode("utf-8-sig").splitlines()
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or "it is not text in UTF-8"
        raise RefusedError(f"serial numbers cannot be read from {path}: {why}") from error
    serials = []
    for number, line in enumerate(lines, start=1):
        if not (serial := line.partition("#")[0].strip()):
            continue
        try:
            serials.append(validate_serial(serial))
        except RefusedError as error:
            raise RefusedError(f"{path} line {number}: {error.reason}", remedy=error.remedy) from error
    if not serials:
        raise RefusedError(f"{path} names no sensor", remedy="write one serial number a line")
    return tuple(dict.fromkeys(serials))


def gather(store: Repository, choice: LotChoice) -> Lot:
    """Gather the runs of a lot and check that they belong together.

    RefusedError if nothing is selected or matches, a sensor is not stored, a run is not good, or runs differ;
    StoreError if a run was altered.
    """
    selected_lines = _select_lines(store, choice)
    chosen_lines = [run for run in selected_lines if run.serial not in choice.without]
    for line in chosen_lines:
        if line.altered:
            raise StoreError(line.altered, remedy="restore the database from a copy, or leave out the sensor")
    not_good = _refuse_bad(chosen_lines, choice)
    runs = [LotRun(run, store.analyses.load(run.run)[0]) for run in chosen_lines if _has_result(run)]
    if not runs:
        raise RefusedError("no run of the lot has measurements", remedy="choose runs that were finished and analysed")
    mixture_note = _describe_mixture(store, runs, choice)
    runs_by_serial: dict[str, tuple[LotRun, ...]] = {}
    for run in sorted(runs, key=lambda lot_run: lot_run.line.serial):
        runs_by_serial[run.line.serial] = (*runs_by_serial.get(run.line.serial, ()), run)
    return Lot(
        chosen=choice.words(),
        sensors={
            serial: tuple(run.line.run for run in sensor_runs) for serial, sensor_runs in runs_by_serial.items()
        },
        stations=tuple(sorted({run.line.station for run in runs})),
        software=tuple(next(iter(runs_by_serial.values()))[0].analysis.software),
        left_out=tuple(sorted({run.serial for run in selected_lines} & set(choice.without))),
        not_good=not_good,
        mixed=mixture_note,
        # Each part once: seeds differ from run to run.
        simulated=tuple(sorted({re.sub(r", seed \d+$", "", part) for run in runs for part in run.line.simulated})),
        analysed=runs_by_serial,
    )


def _select_lines(store: Repository, choice: LotChoice) -> Sequence[RunLine]:
    """Return the runs that fit, those to leave out among them; refuse an unnamed lot, unknown names, and none."""
    if not choice.words():
        raise RefusedError(
            "no golden lot is named",
            remedy="choose runs of sensors known to be good: --serial, --serials FILE, --batch, --recipe, --since",
        )
    check_names(store, RunSelection(serials=(*choice.runs.serials, *choice.without)))
    lines = store.fleet.read_lines(choice.runs)
    if not lines:
        check_names(store, choice.runs)
        raise RefusedError(
            f"no stored run fits the golden lot ({choice.words()})",
            remedy="no stored run matches all of these choices together",
        )
    return lines


def _has_result(run: RunLine) -> bool:
    return run.end is EndReason.FINISHED and run.outcome is not None


def _refuse_bad(runs: Sequence[RunLine], choice: LotChoice) -> tuple[str, ...]:
    bad_runs = [run for run in runs if not (_has_result(run) and run.verdict in _GOOD)]
    fates = tuple(f"{run.serial} ({_describe_outcome(run)})" for run in bad_runs)
    if bad_runs and not choice.include_failed:
        raise RefusedError(
            f"{len(bad_runs)} of the {len(runs)} runs of the lot are not good: {list_names(fates)}",
            remedy="leave those sensors out by --without, choose other days, or take them in by --include-failed",
        )
    return fates


def _describe_outcome(run: RunLine) -> str:
    if run.end is not EndReason.FINISHED:
        return str(run.end)
    if run.overridden_to is not None:
        return f"overridden to {run.overridden_to}"
    return "never analysed" if run.outcome is None else f"{run.outcome}: {run.reason}"


def _describe_mixture(store: Repository, runs: Sequence[LotRun], choice: LotChoice) -> tuple[str, ...]:
    """Describe differences of the runs that affect numbers; refuse them unless they were allowed."""
    # A recipe is named with the digest of everything that affects its numbers.
    digests = [measuring_digest(store.runs.read_configuration(run.line.run))[:8] for run in runs]
    recipes = _group_serials((run, f"{run.line.recipe} {digest}") for run, digest in zip(runs, digests, strict=True))
    software = _group_serials(zip(runs, software_words([run.line for run in runs]), strict=True))
    mixed = tuple(
        f"{noun}: {'; '.join(f'{what} ({list_names(serials)})' for what, serials in groups.items())}"
        for noun, groups in (("recipes", recipes), ("software versions", software))
        if len(groups) > 1
    )
    if mixed and not choice.allow_mixed:
        raise RefusedError(
            f"the lot mixes {' and '.join(mixed)}",
            remedy="narrow it by --recipe, --since, --until or --without, or accept it with --allow-mixed",
        )
    return mixed


def _group_serials(pairs: Iterable[tuple[LotRun, str]]) -> dict[str, list[str]]:
    groups: dict[str, list[str]] = {}
    for run, description in pairs:
        serials = groups.setdefault(description, [])
        if run.line.serial not in serials:
            serials.append(run.line.serial)
    return groups
