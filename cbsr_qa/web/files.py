"""Files of runs: found by the run's identifier in the database, never by a name from a request."""

from http import HTTPStatus
from pathlib import Path
from typing import Final

from starlette.exceptions import HTTPException
from starlette.responses import Response

from cbsr_qa.config.paths import database_url, reports_folder
from cbsr_qa.config.recipe import PICTURES
from cbsr_qa.report.render import report_name
from cbsr_qa.store.opening import open_store
from cbsr_qa.store.repository import Repository
from cbsr_qa.store.runs.live import RunLook
from cbsr_qa.system.foreign import read_foreign
from cbsr_qa.web.channel import ChannelClient
from cbsr_qa.web.guard import REPORT_POLICY
from cbsr_qa.web.texts import text

#: Largest picture of a prompt [B].
_MAX_PICTURE_BYTES: Final = 5_000_000


def _look(store: Repository, run: str) -> RunLook:
    look = store.live.find_run(run)
    if look is None:
        raise HTTPException(HTTPStatus.NOT_FOUND, text("problem.no_run"))
    return look


def report_response(database: str | None, run: str) -> Response:
    """Return the report of a run, as it was written."""
    with open_store(database_url(database)) as store:
        look = _look(store, run)
    try:
        page = (reports_folder() / report_name(look.serial, look.run)).read_bytes()
    except OSError:
        raise HTTPException(HTTPStatus.NOT_FOUND, text("problem.no_report", run=run)) from None
    return Response(page, media_type="text/html", headers={"content-security-policy": REPORT_POLICY})


def calibration_response(database: str | None, run: str) -> Response:
    """Return the calibration file of a run, from the database."""
    with open_store(database_url(database)) as store:
        look = _look(store, run)
        issued = [
            calibration.calibration
            for calibration in store.calibrations.list_issued(look.serial)
            if calibration.run == run
        ]
        stored = store.calibrations.load_file(issued[0]) if issued else None
    if stored is None:
        raise HTTPException(HTTPStatus.NOT_FOUND, text("problem.no_calibration"))
    name = Path(report_name(look.serial, look.run)).with_suffix(".h5").name
    headers = {"content-disposition": f'attachment; filename="{name}"'}
    return Response(stored[0], media_type="application/x-hdf5", headers=headers)


def prompt_picture(channel: ChannelClient, number: int) -> Response:
    """Return the picture of the open prompt; the run names its file, a request only the prompt."""
    control = channel.control
    if control is None or control.prompt is None or control.prompt.number != number or not channel.prompt_picture:
        raise HTTPException(HTTPStatus.NOT_FOUND)
    file = Path(channel.prompt_picture)
    kind = PICTURES.get(file.suffix.lower())
    try:
        if kind is None or not file.is_absolute():
            raise HTTPException(HTTPStatus.NOT_FOUND)
        return Response(read_foreign(file, _MAX_PICTURE_BYTES), media_type=kind)
    except OSError:
        raise HTTPException(HTTPStatus.NOT_FOUND) from None
