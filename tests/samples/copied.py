"""Copies of a process, forked as a plugin might, and how many come back."""

import os
import warnings


def fork(*given, **named):
    """Return in two processes, whatever it is called with."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # newer Pythons, of threads
        return os.fork()


def fork_and_leave(*given, **named):
    """Return in one process, and raise in its copy."""
    if fork() == 0:
        raise SystemExit(0)


def come_back(act):
    """Carry something out in a child of this process, whatever it raises; return how many processes come back."""
    out, into = os.pipe()
    if (child := fork()) == 0:
        try:
            act()
        finally:
            os.write(into, b"x")
            os._exit(0)
    os.close(into)
    os.waitpid(child, 0)
    with os.fdopen(out, "rb") as pipe:
        return len(pipe.read())  # until every copy has ended
