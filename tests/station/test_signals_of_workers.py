"""A signal to a group of processes is answered by the one that was started, not by each of its workers."""

import multiprocessing
import os
import signal
from concurrent.futures import ProcessPoolExecutor

import pytest

from cbsr_qa.station.interrupts import Interrupts


def told(number):
    lines = []
    with Interrupts(lines.append) as interrupts, pytest.raises(KeyboardInterrupt):  # noqa: PT012
        os.kill(os.getpid(), number)
        with interrupts.listen():
            interrupts.poll()
    return lines


def test_a_worker_stops_as_the_program_does_and_says_nothing():
    assert [line.partition(":")[0] for line in told(signal.SIGTERM)] == ["SIGTERM"]
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        assert pool.submit(told, signal.SIGTERM).result() == []
