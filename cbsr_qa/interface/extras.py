"""Libraries of the extra ``notebook``, each imported when it is first needed."""

from importlib import import_module
from typing import Any

from cbsr_qa.domain import RefusedError


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
