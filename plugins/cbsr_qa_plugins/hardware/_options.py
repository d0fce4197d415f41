"""The options of an instrument's table, checked: every refusal names role, driver, key and what is allowed."""

import math
from collections.abc import Sequence
from difflib import get_close_matches
from typing import Any, Final

from cbsr_qa.domain import ConfigError
from cbsr_qa.plugin import StationContext

_MISSING: Final = object()


class InstrumentTable:
    """Reads the options of one instrument.

    Parameters
    ----------
    context : what its factory was given.
    driver : its name, for messages.
    known : every key it may have.

    Raises
    ------
    ConfigError
        If it has another key; the nearest of the known ones is named.
    """

    def __init__(self, context: StationContext, driver: str, known: Sequence[str]) -> None:
        self._options = context.options
        self._who = f"instrument {context.role!r} ({driver})"
        for key in self._options:
            if key not in known:
                near = get_close_matches(key, known, n=1)
                meant = f"did you mean {near[0]!r}? " if near else ""
                raise ConfigError(f"{self._who} has no option {key!r}", remedy=f"{meant}it has {', '.join(known)}")

    def has(self, key: str) -> bool:
        """Whether the table says something under this key."""
        return key in self._options

    def text(self, key: str, default: Any = _MISSING, *, remedy: str = "") -> str:
        """Return a text that is not empty."""
        value = self._value(key, default, remedy or "give it a text")
        if not isinstance(value, str) or not value.strip():
            raise self.wrong(key, value, "it is a text")
        return value

    def choice(self, key: str, allowed: Sequence[str], default: Any = _MISSING) -> str:
        """Return one of these words."""
        value = self._value(key, default, f"it is one of {', '.join(allowed)}")
        if value not in allowed:
            near = get_close_matches(str(value), allowed, n=1)
            meant = f"did you mean {near[0]!r}? " if near else ""
            raise self.wrong(key, value, f"{meant}it is one of {', '.join(allowed)}")
        return str(value)

    def flag(self, key: str, default: bool) -> bool:
        """Return true or false."""
        value = self._value(key, default, "")
        if not isinstance(value, bool):
            raise self.wrong(key, value, "it is true or false")
        return value

    def number(
        self, key: str, default: Any = _MISSING, *, at_least: float = -math.inf, at_most: float = math.inf
    ) -> float:
        """Return a finite number within bounds."""
        allowed = f"it is a finite number{_bounds(at_least, at_most)}"
        value = self._value(key, default, allowed)
        if not _is_number(value) or not at_least <= value <= at_most:
            raise self.wrong(key, value, allowed)
        return float(value)

    def whole(self, key: str, default: Any = _MISSING, *, at_least: int, at_most: int) -> int:
        """Return a whole number within bounds."""
        allowed = f"it is a whole number{_bounds(at_least, at_most)}"
        value = self._value(key, default, allowed)
        if not isinstance(value, int) or isinstance(value, bool) or not at_least <= value <= at_most:
            raise self.wrong(key, value, allowed)
        return value

    def numbers(self, key: str, count: int, default: Any = _MISSING) -> tuple[float, ...]:
        """Return a list of so many finite numbers."""
        allowed = f"it is a list of {count} finite numbers"
        value = self._value(key, default, allowed)
        if not isinstance(value, list | tuple) or len(value) != count or not all(map(_is_number, value)):
            raise self.wrong(key, value, allowed)
        return tuple(float(one) for one in value)

    def _value(self, key: str, default: Any, remedy: str) -> Any:
        value = self._options.get(key, default)
        if value is _MISSING:
            raise ConfigError(f"{self._who} needs option {key!r}", remedy=remedy)
        return value

    def wrong(self, key: str, value: Any, allowed: str) -> ConfigError:
        """Return the refusal of a value."""
        return ConfigError(f"{self._who}: {key} is {value!r}", remedy=allowed)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _bounds(at_least: float, at_most: float) -> str:
    low = f" of at least {at_least:g}" if math.isfinite(at_least) else ""
    high = f"{' and' if low else ' of'} at most {at_most:g}" if math.isfinite(at_most) else ""
    return low + high
