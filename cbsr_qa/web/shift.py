"""What the views of a shift and of a sensor show."""

from typing import Any

from starlette.exceptions import HTTPException

from cbsr_qa.config import database_url, validate_serial
from cbsr_qa.domain.results import RunSelection
from cbsr_qa.store import open_store
from cbsr_qa.web.texts import text


def shift_page(database: str | None, stations: tuple[str, ...]) -> dict[str, Any]:
    """Return what the shift view shows: today's runs of the served stations."""
    from cbsr_qa.studies.shift import local_day, shift_summary  # with all of statistics behind it

    since, until = local_day()
    selection = RunSelection(stations=stations, from_moment=since, before_moment=until, checks=False)
    with open_store(database_url(database)) as store:
        summary = shift_summary(store, selection)
        runs = store.listed_runs(selection)
    return {"day": since, "summary": summary, "runs": tuple(reversed(runs))}


def sensor_page(database: str | None, serial: str) -> dict[str, Any]:
    """Return what the view of a sensor shows."""
    from cbsr_qa.studies.shift import sensor_runs

    validate_serial(serial)
    with open_store(database_url(database)) as store:
        runs = sensor_runs(store, serial)
    if not runs:
        raise HTTPException(404, text("problem.no_sensor", serial=serial))
    return {"serial": serial, "runs": tuple(reversed(runs))}
