"""What instruments share that an operator works by hand: questions that are asked again until the answer is one."""

import math
import re
from collections.abc import Callable, Mapping
from typing import Final, Protocol, runtime_checkable

from cbsr_qa.domain.errors import ConfigError, InstrumentError
from cbsr_qa.interfaces import Instrument, StationContext

#: After so many answers that are none, somebody else should look.
_MOST_ASKED: Final = 5
_NUMBER: Final = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)(e[+-]?\d+)?", re.IGNORECASE)


@runtime_checkable
class HandMoved(Instrument, Protocol):
    """A head that is moved by hand, as a load cell that is read by hand needs to know it."""

    @property
    def orders(self) -> int:
        """How often it was told to go anywhere."""
        ...

    @property
    def down(self) -> bool:
        """Whether it is in the sheet, by all that was told."""
        ...


def hand_moved(peers: Mapping[str, Instrument], what: str) -> HandMoved:
    """Return the bench's head, which must be one that is moved by hand.

    Parameters
    ----------
    what : is read by hand, for the message.

    Raises
    ------
    ConfigError
        If the head moves by itself: it would press on, unwatched, while somebody looks for a display.
    """
    head = peers.get("force_applicator")
    if not isinstance(head, HandMoved):
        raise ConfigError(
            f"{what} that is read by an operator is for a head that is moved by hand",
            remedy="a head that moves by itself needs instruments that sample by themselves",
        )
    return head


class Operator:
    """Asks the operator, and takes no nonsense for an answer.

    Raises
    ------
    ConfigError
        If nobody is there to be asked.
    """

    def __init__(self, context: StationContext, driver: str) -> None:
        if context.ask is None:
            raise ConfigError(
                f"instrument {context.role!r} ({driver}) is worked by hand, and nobody is there to be asked",
                remedy="start the run at a terminal, or use a driver that needs no operator",
            )
        self._role = context.role
        self._ask: Callable[[str], str] = context.ask

    def told(self, text: str) -> None:
        """Ask for something to be done; any answer says that it is."""
        self._ask(f"{self._role}: {text}. Press Enter when done.")

    def number(self, text: str, unit: str, *, least: float, most: float, default: float | None = None) -> float:
        """Ask for a number until there is one within bounds.

        Parameters
        ----------
        text : what is asked for.
        unit : the answer's; it may be typed behind the number.
        least, most : bounds of what can be.
        default : what an empty answer means; None where it means nothing.

        Raises
        ------
        InstrumentError
            If no answer was one.
        """
        question = f"{self._role}: {text} [{unit}]:"
        for _ in range(_MOST_ASKED):
            said = self._ask(question).strip()
            if not said and default is not None:
                return default
            value = _parsed(said, unit)
            if value is not None and least <= value <= most:
                return value
            wrong = f"{said!r} is no number" if value is None else f"{value:g} {unit} is not within its bounds"
            question = f"{self._role}: {wrong}. {text}, from {least:g} to {most:g} [{unit}]:"
        raise InstrumentError(
            self._role, "the operator", f"{_MOST_ASKED} answers were no number of {unit} within {least:g} to {most:g}"
        )


def _parsed(said: str, unit: str) -> float | None:
    """Return the number of an answer such as ``1.5`` or ``1.5 mm``; None where it is none, or not a finite one."""
    text = said.removesuffix(unit).strip()
    if not _NUMBER.fullmatch(text):
        return None
    value = float(text)
    return value if math.isfinite(value) else None
