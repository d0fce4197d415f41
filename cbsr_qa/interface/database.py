"""A database of runs."""

from collections.abc import Sequence
from datetime import date
from typing import TYPE_CHECKING, TypedDict

from cbsr_qa.app.database import DatabaseStatus, database_status
from cbsr_qa.app.export.formats import ExportTable
from cbsr_qa.app.shift.lists import ListRequest, list_request
from cbsr_qa.config.paths import database_url
from cbsr_qa.config.serials import read_parts
from cbsr_qa.interface.result import Result
from cbsr_qa.interface.stored_run import Run
from cbsr_qa.interface.tables import table_of
from cbsr_qa.store.opening import open_store

if TYPE_CHECKING:
    from typing import Unpack

    import pandas as pd


class Selection(TypedDict, total=False):
    """Which runs; as the options of ``cbsr-qa runs``. All given criteria must hold.

    ``since`` and ``until`` are days (UTC, both included); ``today`` is this computer's day; ``latest`` keeps so many
    of the latest that remain; ``checks`` includes runs that checked a station; ``part`` is ``sheet=LOT7/B``.
    """

    serial: str | Sequence[str]
    station: str | Sequence[str]
    operator: str | Sequence[str]
    recipe: str
    batch: str
    part: str | Sequence[str]
    since: date
    until: date
    today: bool
    failed: bool
    limit: str
    latest: int
    checks: bool


def _request(selection: Selection) -> ListRequest:
    several = {"serial": "serials", "station": "stations", "operator": "operators"}
    given = {several.get(name, name): value for name, value in selection.items()}
    for name in several.values():
        if name in given:
            value = given[name]
            given[name] = (value,) if isinstance(value, str) else tuple(value)  # type: ignore[arg-type]
    if "part" in selection:
        part = selection["part"]
        del given["part"]
        given["parts"] = read_parts((part,) if isinstance(part, str) else part)
    return list_request(**given)  # type: ignore[arg-type]


class Database(Result[DatabaseStatus]):
    """A database of runs; made by :func:`open_database`. Nothing stays open between calls."""

    def __init__(self, url: str | None = None) -> None:
        self._url = database_url(url)
        with open_store(self._url, create=False):  # refuses one that is not there
            pass
        super().__init__(database_status(url))

    def runs(self, **selection: "Unpack[Selection]") -> "pd.DataFrame":
        """Return the selected runs, oldest first: the columns of ``cbsr-qa export --table runs``.

        Raises
        ------
        CbsrError
            If a name is of no stored run; the remedy names the nearest one.
        """
        return table_of(self._url, _request(selection), ExportTable.RUNS)

    def measurements(self, **selection: "Unpack[Selection]") -> "pd.DataFrame":
        """Return the measurements of the selected runs: the columns of ``cbsr-qa export --table measurements``.

        Raises as :meth:`runs`.
        """
        return table_of(self._url, _request(selection), ExportTable.MEASUREMENTS)

    def run(self, run: str) -> Run:
        """Return a run by its identifier, or the latest run of a serial number. StoreError if neither is stored."""
        return Run(run, self._url)


def open_database(url: str | None = None) -> Database:
    """Open a database to read from.

    Parameters
    ----------
    url : SQLite file or address of a PostgreSQL database; None for ``CBSR_QA_DATABASE`` or the usual one in ``var/``.

    Raises
    ------
    StoreError
        If it does not exist, or needs an upgrade.
    """
    return Database(url)
