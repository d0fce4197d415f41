"""An operator who is being asked is waited for: nothing hangs meanwhile."""

from collections.abc import Callable
from typing import Generic, TypeVar

A = TypeVar("A")


class Asking(Generic[A]):
    """Asks the operator, and knows while somebody is being asked.

    The runner's own prompts and instruments that are worked by hand must ask through the same one.

    Parameters
    ----------
    ask : shows a text and returns the answer; None where nobody is there.
    """

    def __init__(self, ask: Callable[[str], A] | None) -> None:
        self._ask = ask
        self._waiting = False

    def is_waiting(self) -> bool:
        """Say whether somebody is being asked right now."""
        return self._waiting

    def __call__(self, text: str) -> A:
        """Ask, and return the answer."""
        assert self._ask is not None  # nobody is asked where nobody is there
        self._waiting = True
        try:
            return self._ask(text)
        finally:
            self._waiting = False
