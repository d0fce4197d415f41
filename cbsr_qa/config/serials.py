"""Identifiers typed by people: serial numbers, batches, operators. Only valid ones reach a path or a page."""

import re
import unicodedata
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.system.words import echo

if TYPE_CHECKING:
    from cbsr_qa.domain.sensor.sensor_type import SensorPart

LONGEST = 64

#: Longest reason, which is a sentence or two [characters].
LONGEST_REASON = 500

#: Longest pattern of serial numbers [characters].
LONGEST_PATTERN = 200

_PART_REMEDY = (
    "give what it is, = and its number, as sheet=LOT7, or with a revision sheet=LOT7/B;"
    f" each up to {LONGEST} characters"
)
_IDENTIFIER = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")


def validate_serial(text: str) -> str:
    """Return a valid serial number.

    Raises
    ------
    ConfigError
        Unless it has 1 to 64 ASCII letters, digits, ``.``, ``_`` or ``-`` and starts with a letter or digit.
    """
    return _identifier("serial number", text)


def validate_batch(text: str) -> str:
    """Return a valid batch name, by the rule for serial numbers; may be empty."""
    return _identifier("batch", text) if text else ""


def read_parts(texts: Sequence[str]) -> "tuple[SensorPart, ...]":
    """Return parts of a sensor, typed or scanned as ``NAME=IDENTIFIER/REVISION``, sorted by name.

    The revision, after the last ``/``, may be left out.

    Raises
    ------
    ConfigError
        If one has no ``=``, a name or an identifier that cannot be used, or if a name is given twice.
    """
    from cbsr_qa.domain.sensor.sensor_type import SensorPart  # loads numpy, which no check of a typed name needs

    part_by_name: dict[str, SensorPart] = {}
    for text in texts:
        name, equals, content = text.partition("=")
        if not equals:
            raise ConfigError(f"part {echo(text, 24)} has no =", remedy=_PART_REMEDY)
        _identifier("name of a part", name)
        identifier, slash, revision = content.rpartition("/")
        part = SensorPart(name, identifier, revision) if slash else SensorPart(name, content)
        for noun, value in (("identifier", part.identifier), *((("revision", revision),) if slash else ())):
            if finding := _find_odd(value):
                raise ConfigError(f"{noun} {echo(value, 24)} of part {name} {finding}", remedy=_PART_REMEDY)
        if name in part_by_name:
            raise ConfigError(
                f"part {name} is given twice: {part_by_name[name]} and {part}", remedy="a sensor has one of each name"
            )
        part_by_name[name] = part
    return tuple(part_by_name[name] for name in sorted(part_by_name))


def _find_odd(value: str) -> str:
    """Say why a text cannot identify a part; empty if it can."""
    if not value:
        return "is empty"
    if len(value) > LONGEST:
        return f"is longer than {LONGEST} characters"
    if value != value.strip():
        return "starts or ends with a blank"
    odd = next((character for character in value if not character.isprintable()), "")
    return f"has the character {odd!r}" if odd else ""


def validate_operator(text: str) -> str:
    """Return a valid operator's name; may be empty.

    Raises
    ------
    ConfigError
        If it is longer than 64 characters or holds anything but letters and digits of any script, single
        spaces between them, and ``. _ - '``.
    """
    for character in text:
        if not (unicodedata.category(character)[0] in "LMN" or character in " ._-'’"):
            raise _identifier_error("operator", text, f"{character!r} is not allowed")
    if text != text.strip():
        raise _identifier_error("operator", text, "it starts or ends with a space")
    if "  " in text:
        raise _identifier_error("operator", text, "it has two spaces in a row")
    if len(text) > LONGEST:
        raise _identifier_error("operator", text, f"it is longer than {LONGEST} characters")
    return text


def validate_reason(text: str) -> str:
    """Return a valid reason for a change; may be empty. ConfigError as :func:`validate_line`."""
    return validate_line(text, "reason", LONGEST_REASON)


def validate_line(text: str, noun: str, longest: int) -> str:
    """Return a text that can be printed in one line, without blanks at its ends; may be empty.

    Raises
    ------
    ConfigError
        If it has more characters, or holds line breaks or other invisible characters.
    """
    hidden_character = next(
        (character for character in text if unicodedata.category(character)[0] in "CZ" and character != " "), ""
    )
    finding = f"{hidden_character!r} is not allowed" if hidden_character else ""
    if len(text) > longest:
        finding = f"it has {len(text)} characters"
    if finding:
        raise ConfigError(
            f"{noun} {echo(text, 24)} cannot be used: {finding}",
            remedy=f"allowed: one line of up to {longest} characters",
        )
    return text.strip()


def check_serial_pattern(pattern: str) -> str:
    """Return a valid pattern of serial numbers. ValueError if it is too long, or RE2 does not know it."""
    if len(pattern) > LONGEST_PATTERN:
        raise ValueError(f"it must have at most {LONGEST_PATTERN} characters")
    if not pattern:
        raise ValueError("it must not be empty; leave the key out to allow every serial number")
    _compile_pattern(pattern)
    return pattern


def fits_pattern(pattern: str, serial: str) -> bool:
    """Whether the whole of a serial number matches a pattern; the time grows with its length, for any pattern."""
    return _compile_pattern(pattern).fullmatch(serial) is not None


def _compile_pattern(pattern: str) -> Any:
    import re2  # Python's own ``re`` takes years for some patterns and a serial number of 64 characters

    options = re2.Options()
    options.log_errors = False
    try:
        return re2.compile(pattern, options)
    except re2.error as error:
        reason = error.args[0].decode("utf-8", "replace") if isinstance(error.args[0], bytes) else str(error)
        raise ValueError(f"it must be a regular expression of RE2: {reason}") from None


def _identifier(noun: str, text: str) -> str:
    if not text:
        raise _identifier_error(noun, text, "it is empty")
    if len(text) > LONGEST:
        raise _identifier_error(noun, text, f"it is longer than {LONGEST} characters")
    if not _IDENTIFIER.fullmatch(text):
        character = next((c for c in text if not re.fullmatch(r"[A-Za-z0-9._-]", c)), text[0])
        allowed = "allowed at the start" if character in "._-" else "allowed"
        raise _identifier_error(noun, text, f"{character!r} is not {allowed}")
    return text


def _identifier_error(noun: str, text: str, why: str) -> ConfigError:
    allowed = (
        "letters, digits, single spaces and . _ - '"
        if noun == "operator"
        else "A to Z, a to z, digits and . _ -, starting with a letter or a digit, as S-104"
    )
    return ConfigError(
        f"{noun} {echo(text, 24)} cannot be used: {why}", remedy=f"allowed: 1 to {LONGEST} characters: {allowed}"
    )
