"""An operator who is being asked is waited for: nothing hangs meanwhile."""

from collections.abc import Callable


class Asking:
    """Asks the operator, and says while somebody is being asked.

    The runner's own prompts and instruments that are worked by hand must ask through the same one.

    Parameters
    ----------
    ask : shows a text and returns the answer.
    """

    def __init__(self, ask: Callable[[str], str]) -> None:
        #: Somebody is being asked right now.
        self.waiting = False
        self._ask = ask

    def __call__(self, text: str) -> str:
        """Ask, and return the answer."""
        self.waiting = True
        try:
            return self._ask(text)
        finally:
            self.waiting = False
