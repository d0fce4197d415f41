"""A recipe run at a station of this computer."""

from collections.abc import Callable, Sequence
from pathlib import Path

from cbsr_qa.app.gate.request import Override
from cbsr_qa.app.run.console import Unattended
from cbsr_qa.app.run.outcome import run_outcome
from cbsr_qa.app.run.request import RunRequest
from cbsr_qa.app.run.run import run_sensor
from cbsr_qa.config.serials import read_parts
from cbsr_qa.interface.result import Progress, quiet
from cbsr_qa.interface.stored_run import Run


class _Notebook(Unattended):
    """Functions of a notebook or script; None: nobody answers."""

    def __init__(
        self, progress: Progress, ask: Callable[[str], str] | None, pin: Callable[[str], str] | None
    ) -> None:
        self.attended = ask is not None
        self._progress, self._ask, self._pin = progress, ask, pin

    def tell(self, activity: str) -> None:
        self._progress(activity)

    def ask(self, text: str) -> str:
        return super().ask(text) if self._ask is None else self._ask(text)

    def read_pin(self, text: str) -> str:
        return "" if self._pin is None else self._pin(text)


def run(
    *,
    station: str | Path,
    recipe: str | Path,
    serial: str,
    batch: str = "",
    parts: Sequence[str] = (),
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
    parts : parts of the sensor, each as ``"sheet=LOT7/B"``.
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
        parts=read_parts(parts),
        operator=operator,
        sensor_type=None if sensor_type is None else str(sensor_type),
        material=None if material is None else str(material),
        seed=seed,
        database=database,
        why=why,
        override=Override(tuple(override), override_by, override_why),
    )
    outcome = run_sensor(request, _Notebook(progress or quiet, ask, pin))
    return Run(outcome.run, database, run_outcome(outcome))
