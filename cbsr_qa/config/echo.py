"""Repeating what somebody typed without letting it flood or upset a terminal."""


def echo(text: str, longest: int = 60) -> str:
    """Return text quoted, control characters escaped, cut after ``longest`` characters with its full length said."""
    if len(text) <= longest:
        return repr(text)
    return f"{text[:longest]!r}… ({len(text)} characters)"
