"""Looking after the database: bring it up to date, say how it stands."""

from dataclasses import asdict, dataclass, replace
from typing import Any, Final

from cbsr_qa.config import database_url
from cbsr_qa.domain.results import EndReason
from cbsr_qa.station import on_stderr
from cbsr_qa.store import HEAD, Age, found_version, open_engine, open_store, parsed_url, refusal, upgrade
from cbsr_qa.store.runs import IncompleteRun, counts, incomplete_runs, runs_without_result

#: Ends of runs that somebody or something stopped, as against those that were cut off.
_STOPPED: Final = (str(EndReason.ABORTED), str(EndReason.BROKEN))


@dataclass(frozen=True, slots=True)
class Upgrade:
    """What bringing a database up to date came to; ``before`` is None where it was empty."""

    url: str
    before: str | None
    after: str

    @property
    def changed(self) -> bool:
        """Whether anything had to be done."""
        return self.before != self.after

    def document(self) -> dict[str, Any]:
        """Return the same for ``--json``."""
        return {**asdict(self), "changed": self.changed}


@dataclass(frozen=True, slots=True)
class DatabaseStatus:
    """How a database stands.

    Parameters
    ----------
    url : a password hidden.
    schema, head : version found (None: empty or absent) and version this program reads and writes.
    state : ``"empty"``, ``"current"``, ``"older"``, ``"newer"`` or ``"of another program"``.
    remedy : what to do where it is not current.
    counts : rows by kind.
    incomplete : runs that were cut off or are under way.
    stopped : runs that were aborted or broken, which can be resumed too.
    without_result : (run, serial) of runs whose every step was carried out, and that have no result yet.

    All of them are empty unless the database is current.
    """

    url: str
    schema: str | None
    head: str
    state: str
    remedy: str
    counts: dict[str, int]
    incomplete: tuple[IncompleteRun, ...]
    stopped: tuple[IncompleteRun, ...] = ()
    without_result: tuple[tuple[str, str], ...] = ()

    def document(self) -> dict[str, Any]:
        """Return the same for ``--json``."""
        incomplete = [{**_place(run), "state": state_words(run)} for run in self.incomplete]
        stopped = [{**_place(run), "end": run.end, "detail": run.detail} for run in self.stopped]
        without = [{"run": run, "serial": serial} for run, serial in self.without_result]
        return {**asdict(self), "incomplete": incomplete, "stopped": stopped, "without_result": without}


def _place(run: IncompleteRun) -> dict[str, str]:
    return {"run": run.run, "serial": run.serial, "phase": run.phase, "next": run.next}


def state_words(run: IncompleteRun) -> str:
    """Say how a run that did not finish stands: cut off, under way and by whom, aborted or broken."""
    if run.writer:
        return f"under way: {run.writer}"
    return run.end if run.end in _STOPPED else "cut off"


def _with_next(runs: tuple[IncompleteRun, ...], url: str) -> tuple[IncompleteRun, ...]:
    """Say what resuming would do next, where the recipe's plugins are there to tell; else what was under way."""
    from cbsr_qa.app.run import known_next  # it imports whatever a run needs
    from cbsr_qa.plugin import discover

    plugins = discover()
    with open_store(url, create=False) as store:
        known = [known_next(store, run.run, plugins) for run in runs]
    return tuple(
        run if found is None else replace(run, phase=found[0] or run.phase, next=found[1])
        for run, found in zip(runs, known, strict=True)
    )


def upgrade_database(option: str | None) -> Upgrade:
    """Bring a database to this program's schema, making it where there is none.

    Parameters
    ----------
    option : URL or path; None for ``CBSR_QA_DATABASE`` or the default.

    Raises
    ------
    StoreError
        If it cannot be opened, belongs to another program, or is newer; it is left as it was.
    """
    engine = open_engine(parsed_url(database_url(option)))
    try:
        before = upgrade(engine, tell=on_stderr)
    finally:
        engine.dispose()
    return Upgrade(engine.url.render_as_string(hide_password=True), before.revision, HEAD)


def database_status(option: str | None) -> DatabaseStatus:
    """Say how a database stands, without changing it.

    Raises
    ------
    StoreError
        If it cannot be opened or read.
    """
    engine = open_engine(parsed_url(database_url(option)))
    try:
        version = found_version(engine)
        current = version.age is Age.CURRENT
        unfinished = incomplete_runs(engine) if current else ()
        if unfinished:
            unfinished = _with_next(unfinished, database_url(option))
        return DatabaseStatus(
            url=engine.url.render_as_string(hide_password=True),
            schema=version.revision,
            head=HEAD,
            state=version.age.value,
            remedy="" if current else refusal(engine, version).remedy,
            counts=counts(engine) if current else {},
            incomplete=tuple(run for run in unfinished if run.end not in _STOPPED),
            stopped=tuple(run for run in unfinished if run.end in _STOPPED),
            without_result=runs_without_result(engine) if current else (),
        )
    finally:
        engine.dispose()
