"""Validation of reconstruction plugins' options, before anything is solved."""

from typing import Final

from cbsr_qa.domain import ConfigError

_LARGEST_WHOLE: Final = 10**15  # beyond, a count is a mistake
_SHOWN: Final = 60  # characters of a value that is no number


def number(method: str, name: str, value: object) -> float:
    """Return an option that is a number.

    Raises
    ------
    ConfigError
        If it is anything else, None included, or too large for a double; what range it must lie in is for the method
        to say.
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ConfigError(f"{method}: {name} is {shown(value)}", remedy="allowed: a number")
    try:
        return float(value)
    except OverflowError as error:
        raise ConfigError(
            f"{method}: {name} is a whole number beyond 1.8e308", remedy="allowed: a number that fits a double"
        ) from error


def whole(method: str, name: str, value: object) -> int:
    """Return an option that is a whole number; ConfigError otherwise, None included."""
    if isinstance(value, bool) or not isinstance(value, int):
        raise ConfigError(f"{method}: {name} is {shown(value)}", remedy="allowed: a whole number")
    if abs(value) > _LARGEST_WHOLE:
        raise ConfigError(f"{method}: {name} is beyond ±10¹⁵", remedy="allowed: a whole number up to 10¹⁵")
    return value


def optional_number(method: str, name: str, value: object) -> float | None:
    """Return an option as :func:`number` does, or None if not given."""
    return None if value is None else number(method, name, value)


def optional_whole(method: str, name: str, value: object) -> int | None:
    """Return an option as :func:`whole` does, or None if not given."""
    return None if value is None else whole(method, name, value)


def shown(value: object) -> str:
    """Return a wrong value as an error shows it."""
    try:
        words = repr(value)
    except ValueError:  # Python writes no whole number of more than 4300 digits
        words = f"a {type(value).__name__} too large to show"
    return words if len(words) <= _SHOWN else words[:_SHOWN] + "…"
