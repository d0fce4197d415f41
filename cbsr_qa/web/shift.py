"""What the views of a shift and of a sensor show."""

from typing import Any

from cbsr_qa.config import database_url, validate_serial
from cbsr_qa.store import open_store


def shift_page(database: str | None, stations: tuple[str, ...]) -> dict[str, Any]:
    """Return what the shift view shows."""
    return {}


def sensor_page(database: str | None, serial: str) -> dict[str, Any]:
    """Return what the view of a sensor shows."""
    validate_serial(serial)
    with open_store(database_url(database), create=False) as store:
        return {"serial": serial, "runs": store.find_runs(serial)}
