"""Names with what they are of, as a reader says them, and which text may name anything."""

from cbsr_qa.domain.errors import RefusedError


def check_encodable(what: str, *texts: str) -> None:
    """Refuse text that no file, database or page can hold: halves of characters (lone surrogates).

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
                f"{what} holds {text[:60]!r}, which is no text that can be written", remedy="write it in UTF-8"
            ) from None


def with_type(found: object) -> str:
    """Return a value of a wrong type as a message shows it: ``5 (int)``, ``an array``; its ``repr`` may raise."""
    kind = type(found).__name__.removeprefix("nd")
    text = repr(found) if isinstance(found, str | int | float | complex | None) else ""
    if text:
        return f"{text[:60]} ({kind})"
    return f"{'an' if kind[0].lower() in 'aeiou' else 'a'} {kind}"


def of_kind(kind: str, name: str) -> str:
    """Return ``station bench-a``; a name that says its kind itself is not told twice: ``station-B``.

    Parameters
    ----------
    kind : one lower-case word, e.g. ``"station"``.
    """
    return name if name.casefold().startswith(kind) else f"{kind} {name}"
