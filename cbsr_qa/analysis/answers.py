"""The answer of a metric, validated as soon as it is called: nothing else can be stored, judged and shown."""

import math
import re
from collections.abc import Callable, Iterable
from dataclasses import fields, replace
from itertools import islice
from numbers import Integral, Real
from typing import Any, Final

from cbsr_qa.domain.errors import PluginError
from cbsr_qa.domain.numbers import with_type
from cbsr_qa.domain.plan.limits import Bound, Outcome
from cbsr_qa.domain.results.measurement import Measurement

#: Largest number of measurements from one call; more are refused, as a generator may never end.
MOST_ANSWERS: Final = 10_000
#: Longest text of a measurement [characters].
LONGEST_TEXT: Final = 2_000
#: Control characters, which databases and pages do not take, and halves of characters.
_UNWRITABLE: Final = re.compile("[\x00-\x1f\x7f-\x9f\ud800-\udfff]")
#: Largest whole number that every database accepts.
_LARGEST: Final = 2**31 - 1


def validate_answer(answer: Iterable[Measurement]) -> list[Measurement]:
    """Validate a metric's answer as plain measurements.

    Numpy's and whole numbers become floats; fields set after construction are checked too.

    Raises
    ------
    PluginError
        Names measurement, field, what was found and what is allowed. Exceptions of the metric itself propagate.
    """
    if isinstance(answer, Measurement) or not isinstance(answer, Iterable):
        raise PluginError(f"it returned {with_type(answer)}; it must return a tuple of Measurement")
    measurements = list(islice(answer, MOST_ANSWERS + 1))
    if len(measurements) > MOST_ANSWERS:
        raise PluginError(f"it returned more than {MOST_ANSWERS} measurements")
    return [_validate_measurement(number, measurement) for number, measurement in enumerate(measurements, start=1)]


def _validate_measurement(number: int, measurement: object) -> Measurement:
    if type(measurement) is not Measurement:
        raise PluginError(f"measurement {number} is {with_type(measurement)}; it must be a Measurement")
    plain_fields: dict[str, Any] = {}
    for name in (field.name for field in fields(Measurement)):
        value = getattr(measurement, name, None)
        check, allowed = _FIELDS[name]
        plain_fields[name] = check(value)
        if plain_fields[name] is _WRONG:
            raise PluginError(f"measurement {number}: {name} is {with_type(value)}; it must be {allowed}")
    return replace(measurement, **plain_fields)


#: Value that a check returns for a value that is not allowed.
_WRONG: Final = object()


def _number(value: object) -> object:
    # Not bool: a metric that answers True has compared something and gives no quantity.
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, Real):
        return _WRONG
    try:
        number = float(value)
        exact = number == value
    except (OverflowError, ValueError, TypeError):
        return _WRONG
    return number if exact and math.isfinite(number) else _WRONG


def _read_whole_number(value: object) -> object:
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, Integral) or not 0 <= int(value) <= _LARGEST:
        return _WRONG
    return int(value)


def _text(value: object) -> object:
    if not isinstance(value, str) or len(value) > LONGEST_TEXT or _UNWRITABLE.search(value):
        return _WRONG
    return str.__str__(value)  # plain also where it is numpy's or an enumeration's


def _unset(value: object) -> Callable[[object], object]:
    return lambda field_value: value if field_value is value else _WRONG


_TEXT: Final = (_text, f"text of at most {LONGEST_TEXT} characters without control characters")
_NAMED: Final = (
    lambda value: _text(value) if value else _WRONG,
    f"text of 1 to {LONGEST_TEXT} characters without control characters",
)
_NUMBER: Final = (_number, "a finite real number that a float holds exactly, or None")
_WHOLE: Final = (_read_whole_number, f"a whole number from 0 to {_LARGEST}, or None")

#: Field → conversion to a plain value, and what is allowed in words.
_FIELDS: Final[dict[str, tuple[Callable[[object], object], str]]] = {
    **dict.fromkeys(("name", "unit"), _NAMED),
    **dict.fromkeys(("phase", "location", "qualifier", "how"), _TEXT),
    **dict.fromkeys(("value", "uncertainty", "strain"), _NUMBER),
    **dict.fromkeys(("trial", "load"), _WHOLE),
    "bound": (lambda value: value if isinstance(value, Bound) else _WRONG, "a Bound"),
    "limit": (_unset(None), "None: the recipe's limits judge"),
    "outcome": (_unset(Outcome.NOT_JUDGED), "NOT_JUDGED: the recipe's limits judge"),
}
