"""A plugin's failure stays the plugin's: nothing it raises ends the program or passes for the user's own stop."""

from collections.abc import Iterator
from contextlib import contextmanager

from cbsr_qa.domain.errors import CbsrError, PluginError
from cbsr_qa.system.copies import end_forked_copies
from cbsr_qa.system.words import describe_error


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
    return describe_error(error)


@contextmanager
def blame_plugin(who: str) -> Iterator[None]:
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
        with end_forked_copies():
            yield
    except CbsrError:
        raise
    except BaseException as error:
        raise PluginError(
            f"{who} failed: {failure(error)}", remedy="report it to the plugin's author, or do without that plugin"
        ) from error
