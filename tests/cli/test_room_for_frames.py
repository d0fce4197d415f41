"""Calls of a command cost no system calls, however deep in the program they are."""

import resource
import sys

import pytest

from cbsr_qa.cli.main import _roomy

_CALLS = 200
_DEEPEST = 300  # frames; a block of CPython holds 16 KB, some 150 of these


def _leaf() -> None:
    pass


def _faults(depth: int) -> int:
    """Pages that the operating system gives out during calls at a depth."""
    if depth:
        return _faults(depth - 1)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(_CALLS):
        _leaf()
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before


@pytest.mark.skipif(sys.platform != "linux" or sys.implementation.name != "cpython", reason="counts pages of Linux")
def test_no_depth_of_a_command_takes_memory_anew_for_every_call():
    assert _roomy(lambda: max(map(_faults, range(_DEEPEST)))) < _CALLS / 4
