"""People at a run: what it tells them, and what it asks them."""

from typing import Protocol

from cbsr_qa.station.control.status import RunStatus
from cbsr_qa.station.progress import RunProgress
from cbsr_qa.system.clock import Clock


class RunConsole(Protocol):
    """Where a run tells people what it does, and asks them: a terminal, a notebook, or nowhere.

    Others follow it over its control channel; see :class:`~cbsr_qa.app.run.control.Control`.
    """

    @property
    def attended(self) -> bool:
        """Whether prompts are answered; otherwise they, and instruments worked by hand, are refused."""

    @property
    def asks_by_channel(self) -> bool:
        """Whether prompts are answered over the control channel, instead of by :meth:`ask`."""

    def tell(self, activity: str) -> None:
        """Say what is done now."""

    def begin(self, run: str) -> None:
        """Take the identifier of a run before anything of it is stored."""

    def show_steps(self, phases: int, clock: Clock, status: RunStatus) -> RunProgress:
        """Return the subscriber that shows the steps of a run with so many phases."""

    def ask(self, text: str) -> str:
        """Show a text to the operator and return the answer. Called only if attended."""

    def read_pin(self, text: str) -> str:
        """Show a text and return the PIN of the operator; empty if none was given."""


class Unattended:
    """Nobody is there: nothing is shown, and nothing is answered."""

    attended = False
    asks_by_channel = False

    def tell(self, activity: str) -> None:
        """Say nothing."""

    def begin(self, run: str) -> None:
        """Keep nothing."""

    def show_steps(self, phases: int, clock: Clock, status: RunStatus) -> RunProgress:
        return RunProgress(phases, clock, status, tell=self.tell)

    def ask(self, text: str) -> str:
        raise NotImplementedError(text)  # prompts of a run that is not attended are refused before it begins

    def read_pin(self, text: str) -> str:
        return ""


#: The console of a run that nobody attends.
NOBODY = Unattended()
