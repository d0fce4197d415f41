"""Kills the process that measures once the phase named in ``ORACLE_KILL_AFTER`` has finished, or fails as asked.

``ORACLE_FAIL``: ``load`` fails while it is loaded, ``phase`` when a phase has finished, ``random`` where the
program draws its first random number, where no plugin is to blame.
"""

import os
import signal

import numpy as np
import pluggy

hookimpl = pluggy.HookimplMarker("cbsr_qa")
_FAIL = os.environ.get("ORACLE_FAIL")


def _failing(*_arguments: object, **_options: object) -> None:
    raise RuntimeError("asked to fail where random numbers are drawn")


if _FAIL == "load":
    raise RuntimeError("asked to fail while it is loaded")
if _FAIL == "random":
    np.random.Philox = _failing


@hookimpl
def cbsr_phase_finished(phase: str) -> None:
    """Send SIGKILL to this process if the phase is the one to die after."""
    if _FAIL == "phase":
        raise RuntimeError("asked to fail when a phase has finished")
    if phase == os.environ.get("ORACLE_KILL_AFTER"):
        os.kill(os.getpid(), signal.SIGKILL)
