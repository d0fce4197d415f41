"""JSON that others wrote, read without tolerance: ambiguous text is refused."""

import json
import math
import re
from itertools import accumulate
from typing import Any, Final, NoReturn

#: Most levels of lists and objects; no document of ours has more than ten.
_MAX_DEPTH: Final = 64
_NOT_BRACKETS: Final = re.compile(r'"[^"\\]*+(?:\\.[^"\\]*+)*+"?|[^][{}"]+', re.DOTALL)
_STEPS: Final = {"[": 1, "{": 1, "]": -1, "}": -1}
#: Most digits of a whole number; no count, seed or time has as many.
_MAX_DIGITS: Final = 40
#: Longest part of the text in a message.
_MAX_QUOTE_LENGTH: Final = 60


def parse_json(text: str | bytes) -> Any:
    """Return the value of a JSON text (RFC 8259); bytes are UTF-8.

    ValueError, in words for its reader, if it is not JSON, an object has a key twice, a number is NaN, infinite or
    too large, or lists and objects are nested more than 64 deep.
    """
    decoded = text if isinstance(text, str) else text.decode("utf-8-sig")
    if decoded.count("[") + decoded.count("{") > _MAX_DEPTH:  # fewer cannot be nested deeper
        depths = accumulate(_STEPS[bracket] for bracket in _NOT_BRACKETS.sub("", decoded))
        if max(depths, default=0) > _MAX_DEPTH:
            raise ValueError(f"lists and objects are nested more than {_MAX_DEPTH} deep")
    return json.loads(
        decoded,
        object_pairs_hook=_build_object,
        parse_constant=_refuse_constant,
        parse_float=_parse_float,
        parse_int=_parse_int,
    )


def _build_object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) != len(pairs):
        seen_keys: set[str] = set()
        repeated_key = next(key for key, _ in pairs if key in seen_keys or seen_keys.add(key))  # type: ignore[func-returns-value]
        raise ValueError(f"the key {repeated_key[:_MAX_QUOTE_LENGTH]!r} appears twice in one object")
    return content


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is not a number in JSON")


def _parse_float(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"the number {text[:_MAX_QUOTE_LENGTH]} is too large")
    return value


def _parse_int(text: str) -> int:
    if len(text) > _MAX_DIGITS:
        raise ValueError(f"the number {text[:_MAX_QUOTE_LENGTH]} is too large")
    return int(text)
