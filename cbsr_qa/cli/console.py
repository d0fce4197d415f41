"""Consoles of a run that ``cbsr-qa`` makes: the terminal, and the page of a line."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cbsr_qa.cli.output import announce, ask_operator, operator_is_there, read_pin
from cbsr_qa.cli.supervised import report_run

if TYPE_CHECKING:
    from cbsr_qa.station.control.status import RunStatus
    from cbsr_qa.station.progress import RunProgress
    from cbsr_qa.system.clock import Clock


@dataclass(frozen=True, slots=True)
class Terminal:
    """The terminal: stages and progress on stderr, questions answered on stdin; the parent is told of the run.

    Parameters
    ----------
    database : database of the run; None for the default.
    """

    database: str | None = None

    @property
    def attended(self) -> bool:
        return operator_is_there()

    @property
    def asks_by_channel(self) -> bool:
        return False

    def tell(self, activity: str) -> None:
        announce(activity)

    def begin(self, run: str) -> None:
        report_run(run, self.database)

    def show_steps(self, phases: int, clock: "Clock", status: "RunStatus") -> "RunProgress":
        from cbsr_qa.station.progress import RunProgress  # with numpy, which the help of commands does without

        return RunProgress(phases, clock, status)

    def ask(self, text: str) -> str:
        return ask_operator(text)

    def read_pin(self, text: str) -> str:
        return read_pin(text)


class PageOfLine(Terminal):
    """The page of a line, which began the run: prompts are answered there, over the run's control channel."""

    __slots__ = ()

    @property
    def attended(self) -> bool:
        return True

    @property
    def asks_by_channel(self) -> bool:
        return True
