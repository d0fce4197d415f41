"""Options of reconstruction plugins: checked when the plugin is made, before anything is solved."""

from typing import overload

from cbsr_qa.domain.errors import ConfigError


@overload
def number(method: str, name: str, value: float) -> float: ...
@overload
def number(method: str, name: str, value: float | None) -> float | None: ...
def number(method: str, name: str, value: object) -> float | None:
    """Return an option that is a number, or None where it was not given.

    Raises
    ------
    ConfigError
        If it is anything else; what range it must lie in is for the method to say.
    """
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ConfigError(f"{method}: {name} is {value!r}", remedy="allowed: a number")
    return float(value)


def whole(method: str, name: str, value: object) -> int | None:
    """Return an option that is a whole number, or None where it was not given; ConfigError if it is anything else."""
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int):
        raise ConfigError(f"{method}: {name} is {value!r}", remedy="allowed: a whole number")
    return value
