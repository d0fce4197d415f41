"""Validation of numbers and text from callers."""

import re
from collections.abc import Collection
from difflib import get_close_matches
from numbers import Integral
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cbsr_qa.domain.errors import NumericsError, RefusedError

Array = NDArray[np.float64]  #: real numbers in double precision
Indices = NDArray[np.int64]  #: places in another array
Mask = NDArray[np.bool_]  #: which entries of another array
#: Digits of a number in a name that are compared.
_MOST_DIGITS: Final = 18


def real_numbers(values: ArrayLike, what: str, *, remedy: str = "") -> NDArray[np.float64]:
    """Return real numbers as float64; an array of float64 is not copied.

    Complex numbers, text and booleans are refused, as a cast drops imaginary parts and parses text.

    Parameters
    ----------
    values : any shape; lists of lists as well.
    what : plural noun that begins the message.
    remedy : remedy for values of another type; there is a default.

    Raises
    ------
    NumericsError
        Naming the type found.
    """
    array = array_of(values, what)
    if array.dtype.kind not in "fiu":
        parts = "give real parts or magnitudes" if array.dtype.kind == "c" else "give integers or floats"
        raise NumericsError(f"{what} are of type {array.dtype}, not real numbers", remedy=remedy or parts)
    return np.asarray(array, dtype=np.float64)


def finite_numbers(values: ArrayLike, what: str) -> NDArray[np.float64]:
    """Return numbers as float64, all of them finite.

    Parameters
    ----------
    what : plural noun that begins the message.

    Raises
    ------
    NumericsError
        If one is NaN or infinite, naming the first.
    """
    array = np.asarray(values, dtype=np.float64)
    bad_indices = np.flatnonzero(~np.isfinite(array))
    if bad_indices.size:
        raise NumericsError(
            f"{what}: value {bad_indices[0]} (from 0) is {array.flat[bad_indices[0]]}, not a finite number",
            remedy="leave such values out",
        )
    return array


def array_of(values: ArrayLike, what: str) -> NDArray[Any]:
    """Return values as an array of any type.

    Raises
    ------
    NumericsError
        If nested lists have different lengths.
    """
    try:
        return np.asarray(values)
    except (ValueError, TypeError) as error:
        raise NumericsError(
            f"{what} are rows of different lengths, not an array", remedy="give rows of one length"
        ) from error


def is_whole(value: object) -> bool:
    """Whether a value is an integer; booleans are not."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def check_encodable(what: str, *texts: str) -> None:
    """Refuse text that no file, database or page can hold: lone surrogates.

    Raises
    ------
    RefusedError
        If one cannot be encoded as UTF-8; names ``what`` and the text.
    """
    for text in texts:
        try:
            text.encode()
        except UnicodeEncodeError:
            raise RefusedError(
                f"{what} is {text[:60]!r}, which cannot be encoded as text", remedy="write it in UTF-8"
            ) from None


def with_type(found: object) -> str:
    """Describe a value of a wrong type for a message: ``5 (int)``, ``an array``; its ``repr`` may raise."""
    kind = type(found).__name__.removeprefix("nd")
    text = repr(found) if isinstance(found, str | int | float | complex | None) else ""
    if text:
        return f"{text[:60]} ({kind})"
    return f"{'an' if kind[0].lower() in 'aeiou' else 'a'} {kind}"


def did_you_mean(name: str, known: Collection[str]) -> str:
    """Suggest the nearest known name; empty if none is near."""
    found = find_nearest(name, known)
    return f"did you mean {found!r}?" if found else ""


def find_nearest(name: str, known: Collection[str]) -> str:
    """Return the nearest known name; empty if none is near.

    Numbers in names count as numbers: S-5 is near S-05, and S-31 nearer to S-30 than to S-13.
    """
    letters, numbers = _split_numbers(name)
    numbers_of_alike = {other: split[1] for other in known if (split := _split_numbers(other))[0] == letters}
    same = [other for other, values in numbers_of_alike.items() if values == numbers]
    close = same or get_close_matches(name, known, n=len(known) or 1)
    alike = [other for other in close if other in numbers_of_alike]
    if alike:
        return min(alike, key=lambda other: _distance(numbers_of_alike[other], numbers))
    by_folded = {other.casefold(): other for other in known}
    close = close or [by_folded[other] for other in get_close_matches(name.casefold(), by_folded, n=1)]
    return close[0] if close else ""


def _split_numbers(name: str) -> tuple[str, tuple[int, ...]]:
    """Return a name without case and separators and with # for each number, and the numbers."""
    plain = re.sub(r"[-_ ./]", "", re.sub(r"[0-9]+", "#", name.casefold()))
    return plain, tuple(int(digits[-_MOST_DIGITS:]) for digits in re.findall(r"[0-9]+", name))


def _distance(numbers: tuple[int, ...], others: tuple[int, ...]) -> int:
    return sum(abs(number - other) for number, other in zip(numbers, others, strict=True))


def prefix_kind(kind: str, name: str) -> str:
    """Return ``station bench-a``; a name that contains its kind is not prefixed: ``station-B``.

    Parameters
    ----------
    kind : one lower-case word, e.g. ``"station"``.
    """
    return name if name.casefold().startswith(kind) else f"{kind} {name}"
