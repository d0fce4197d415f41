"""Stored runs and measurements as data frames, by libraries of the extra ``notebook``, imported when first needed."""

from datetime import datetime
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

from cbsr_qa.app.export.formats import ExportTable
from cbsr_qa.app.export.tables import read_whole_table
from cbsr_qa.app.shift.lists import ListRequest
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.store.opening import open_store

if TYPE_CHECKING:
    import pandas as pd

#: Types of columns; any value but a key may be absent.
_KINDS: Final[dict[type, str]] = {float: "float64", int: "Int64", bool: "boolean", datetime: "datetime64[us, UTC]"}


def table_of(url: str, request: ListRequest, table: ExportTable) -> "pd.DataFrame":
    """Return a table of the selected runs: the columns of ``cbsr-qa export --table``."""
    pandas = notebook_library("pandas", f"a table of {table}")
    with open_store(url, create=False) as store:
        columns, rows = read_whole_table(store, request, table)
    values: dict[str, Any] = {name: [row[n] for row in rows] for n, name in enumerate(columns)}
    made = {name: pandas.Series(values[name], dtype=_KINDS.get(kind, "object")) for name, kind in columns.items()}
    return pandas.DataFrame(made)


def notebook_library(name: str, what: str) -> Any:
    """Import pandas or xarray. RefusedError with the remedy where it is not installed.

    Parameters
    ----------
    what : it is needed for.
    """
    try:
        return import_module(name)
    except ImportError as error:
        raise RefusedError(
            f"{what} needs {name}, which is not installed", remedy="pip install 'cbsr-qa[notebook]'"
        ) from error
