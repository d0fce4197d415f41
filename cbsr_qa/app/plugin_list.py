"""Which plugins there are."""

from difflib import get_close_matches

from cbsr_qa.domain.errors import PluginError
from cbsr_qa.hookspecs import Kind


def kind_named(name: str | None) -> Kind | None:
    """Return the kind of plugin a user named, None for every kind.

    Raises
    ------
    PluginError
        If there is no such kind.
    """
    if name is None:
        return None
    try:
        return Kind(name)
    except ValueError:
        kinds = [str(kind) for kind in Kind]
        near = get_close_matches(name, kinds, n=1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        raise PluginError(f"there is no kind of plugin {name!r}", remedy=f"{hint}kinds: {', '.join(kinds)}") from None
