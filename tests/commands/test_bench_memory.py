"""The memory of a command is its own, whatever this process and its other children took."""

import sys

import numpy as np

from benchmarks.timing import whole_command


def holding(megabytes):
    return [sys.executable, "-c", f"held = bytearray({megabytes} << 20)"]


def test_memory_is_measured_by_process():
    held = np.ones(60 << 17)  # 60 MB here
    _, large = whole_command(holding(200))
    _, small = whole_command(holding(0))
    assert large > 200
    assert small < 50 < held.nbytes >> 20
