"""Looking after the database: bring it up to date, say how it stands."""

from dataclasses import asdict, dataclass
from typing import Any

from cbsr_qa.config.paths import database_url
from cbsr_qa.store.engine import open_engine, parsed_url
from cbsr_qa.store.incomplete import IncompleteRun, counts, incomplete_runs
from cbsr_qa.store.schema import HEAD, Age, found_version, refusal, upgrade


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
    counts : rows by kind, and ``incomplete`` the runs that were cut off or are under way; both empty unless current.
    """

    url: str
    schema: str | None
    head: str
    state: str
    remedy: str
    counts: dict[str, int]
    incomplete: tuple[IncompleteRun, ...]

    def document(self) -> dict[str, Any]:
        """Return the same for ``--json``."""
        return {**asdict(self), "incomplete": [asdict(run) for run in self.incomplete]}


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
        before = upgrade(engine)
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
        return DatabaseStatus(
            url=engine.url.render_as_string(hide_password=True),
            schema=version.revision,
            head=HEAD,
            state=version.age.value,
            remedy="" if current else refusal(engine, version).remedy,
            counts=counts(engine) if current else {},
            incomplete=incomplete_runs(engine) if current else (),
        )
    finally:
        engine.dispose()
