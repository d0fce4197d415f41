"""Validation of effect parameters."""

import sys
from typing import Any, Final

from cbsr_qa.domain import ConfigError

_LARGEST: Final = sys.float_info.max
#: Beyond any quantity of a scene: its square is still a number, and so is its ratio to the smallest that counts.
_BEYOND: Final = 1e15


def number(name: str, value: Any, *, least: float = 0.0, most: float = _BEYOND, above: bool = False) -> float:
    """A finite number in a range.

    Parameters
    ----------
    name : of the parameter, with its unit.
    least, most : the range.
    above : whether ``least`` itself is not allowed.

    Raises
    ------
    ConfigError
        Naming the parameter, what was given and what is allowed.
    """
    good = isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= _LARGEST
    if good and (least < value if above else least <= value) and value <= most:
        return float(value)
    low = f"above {least:g}" if above else f"of at least {least:g}"
    raise ConfigError(f"{name} is {shown(value)}", remedy=f"it must be a finite number {low} and at most {most:g}")


def shown(value: Any) -> str:
    """A given value as short text: whole numbers may have thousands of digits."""
    if isinstance(value, int) and abs(value) > _LARGEST:
        return "a whole number beyond 1.8e308"
    said = repr(value)
    return said if len(said) <= 60 else f"{said[:57]}..."


def whole(name: str, value: Any, *, least: int, most: int) -> int:
    """A whole number in a range.

    Raises
    ------
    ConfigError
        Naming the parameter, what was given and what is allowed.
    """
    if isinstance(value, int) and not isinstance(value, bool) and least <= value <= most:
        return value
    raise ConfigError(f"{name} is {shown(value)}", remedy=f"it must be a whole number from {least} to {most}")


def electrode(name: str, value: Any, count: int) -> int:
    """Number of an electrode.

    Raises
    ------
    ConfigError
        If there is no such electrode.
    """
    if isinstance(value, int) and not isinstance(value, bool) and 0 <= value < count:
        return value
    raise ConfigError(f"{name} is {shown(value)}", remedy=f"electrodes are numbered from 0 to {count - 1}")
