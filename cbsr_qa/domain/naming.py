"""Names with what they are of, as a reader says them."""


def of_kind(kind: str, name: str) -> str:
    """Return ``station bench-a``; a name that says its kind itself is not told twice: ``station-B``.

    Parameters
    ----------
    kind : one lower-case word, e.g. ``"station"``.
    """
    return name if name.casefold().startswith(kind) else f"{kind} {name}"
