"""Repeating what somebody typed without letting it flood or upset a terminal."""


def echo(text: str, longest: int = 60) -> str:
    """Return text quoted, control characters escaped, cut after ``longest`` characters with its full length said."""
    if len(text) <= longest:
        return repr(text)
    return f"{text[:longest]!r}… ({len(text)} characters)"


def printable(text: str) -> str:
    """Return text as it is where it can be printed, otherwise quoted and escaped as by :func:`echo`."""
    return text if text.isprintable() else echo(text, 200)


def plainly(number: float) -> str:
    """Return a number in few digits, unless that would be another number."""
    short = f"{number:g}"
    return short if float(short) == number else repr(number)
