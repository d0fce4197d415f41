"""A recipe run at a station of this computer."""

from collections.abc import Callable, Sequence
from pathlib import Path

from cbsr_qa.app.gate.request import Override
from cbsr_qa.app.run.outcome import run_outcome
from cbsr_qa.app.run.run import RunRequest, run_sensor
from cbsr_qa.interface.result import Progress, quiet
from cbsr_qa.interface.stored_run import Run


def run(
    *,
    station: str | Path,
    recipe: str | Path,
    serial: str,
    batch: str = "",
    operator: str = "",
    why: str = "",
    sensor_type: str | Path | None = None,
    material: str | Path | None = None,
    seed: int | None = None,
    database: str | None = None,
    override: Sequence[str] = (),
    override_by: str = "",
    override_why: str = "",
    ask: Callable[[str], str] | None = None,
    pin: Callable[[str], str] | None = None,
    progress: Progress | None = None,
) -> Run:
    """Test one sensor, as ``cbsr-qa run`` does with the same options: it is stored, judged, reported and calibrated.

    If the kernel is interrupted (Ctrl-C), the run stops and the head is lifted, as in a terminal.

    Parameters
    ----------
    ask : shows a prompt of the recipe and returns the answer, e.g. ``input``; None refuses recipes with prompts.
    pin : shows a text and returns the operator's PIN, e.g. ``getpass.getpass``.
    progress : receives what is being done, in words, e.g. ``print``; by default nothing is shown.

    Returns
    -------
    The run, also one that failed, was aborted or broke off: ``run.result.end`` and ``run.verdict`` say so.

    Raises
    ------
    CbsrError
        Before anything moves, if the run is refused; or if it could not be stored.
    """
    request = RunRequest(
        station=str(station),
        recipe=str(recipe),
        serial=serial,
        batch=batch,
        operator=operator,
        sensor_type=None if sensor_type is None else str(sensor_type),
        material=None if material is None else str(material),
        seed=seed,
        database=database,
        why=why,
        override=Override(tuple(override), override_by, override_why),
    )
    tell = progress or quiet
    outcome = run_sensor(request, tell=tell, ask=ask, pin=pin, show=tell)
    return Run(outcome.run, database, run_outcome(outcome))
