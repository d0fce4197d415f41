"""A plugin's failure stays the plugin's: nothing it raises ends the program or passes for the user's own stop."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from cbsr_qa.domain import CbsrError, PluginError
from cbsr_qa.system import come_back_once

#: Longer messages of plugins are cut [characters].
_LONGEST: Final = 500


class Interruption(BaseException):
    """Breaks into a plugin's code from outside; the plugin is not to blame for it."""


def failure(error: BaseException) -> str:
    """Describe in one line why a plugin's code failed.

    Call it from ``except BaseException``: ``SystemExit`` and the like are a plugin's failure as any other error is.

    Raises
    ------
    BaseException
        The same error, if it is not the plugin's: Ctrl-C, an :class:`Interruption`, a closed generator.
    """
    if isinstance(error, KeyboardInterrupt | GeneratorExit | Interruption):
        raise error
    return said(error)


def said(error: BaseException) -> str:
    """Return type and message of an error, printable and of limited length; never raises."""
    try:
        text = error.reason if isinstance(error, CbsrError) else f"{type(error).__name__}: {error}"
    except KeyboardInterrupt:
        raise
    except BaseException:  # noqa: BLE001 - even its message is a stranger's code
        text = type(error).__name__
    plain = "".join(c if c.isprintable() or c == "\n" else "\N{REPLACEMENT CHARACTER}" for c in text[:_LONGEST])
    return plain + "…" * (len(text) > _LONGEST)


@contextmanager
def contained(who: str) -> Iterator[None]:
    """Blame a plugin for what its code raises; a copy of this process that it forked ends here.

    Parameters
    ----------
    who : kind and name of the plugin, e.g. ``"metric 'creep'"``.

    Raises
    ------
    PluginError
        Naming the plugin, for every error that is not of this package on purpose; those pass as they are.
    """
    try:
        with come_back_once():
            yield
    except CbsrError:
        raise
    except BaseException as error:
        raise PluginError(
            f"{who} failed: {failure(error)}", remedy="report it to the plugin's author, or do without that plugin"
        ) from error
