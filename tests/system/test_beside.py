"""Independent pieces of work, shared with a helper."""

import os
import signal

import pytest

from cbsr_qa.system import side_by_side

#: Tasks of a test: enough that a helper takes some of them.
COUNT = 40


@pytest.fixture(params=[1, 2], ids=["one processor", "two processors"])
def processors(request, monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(request.param)))
    return request.param


def _slowly(value):
    signal.pthread_sigmask(signal.SIG_BLOCK, ())  # any system call: the other process has its turn
    return sum(range(20_000)) * 0 + value, os.getpid()


def test_results_come_in_order_from_both_processes(processors):
    results = side_by_side([lambda k=k: _slowly(k) for k in range(COUNT)])
    assert [value for value, _ in results] == list(range(COUNT))
    assert len({process for _, process in results}) <= processors


def _raises(error):
    raise error


@pytest.mark.parametrize("error", [ValueError("bad"), KeyboardInterrupt(), SystemExit(3)], ids=repr)
def test_errors_are_raised_here_wherever_they_happened(processors, error):
    tasks = [lambda k=k: _slowly(k) if k % 7 else _raises(error) for k in range(1, COUNT)]
    with pytest.raises(type(error)):
        side_by_side(tasks)


def test_the_first_of_several_errors_is_raised(processors):
    tasks = [lambda k=k: _slowly(k) if k < 5 else _raises(ValueError(k)) for k in range(COUNT)]
    with pytest.raises(ValueError, match=r"^5$"):
        side_by_side(tasks)


def test_what_a_killed_helper_had_taken_is_done_here(processors):
    here = os.getpid()

    def task(k):
        if os.getpid() != here:
            os.kill(os.getpid(), signal.SIGKILL)
        return _slowly(k)[0]

    assert side_by_side([lambda k=k: task(k) for k in range(COUNT)]) == list(range(COUNT))


def test_results_that_cannot_be_pickled_are_made_here(processors):
    results = side_by_side([lambda k=k: lambda: _slowly(k)[0] for k in range(COUNT)])
    assert [result() for result in results] == list(range(COUNT))


def test_no_helper_is_left_behind(processors):
    workers = set(side_by_side([lambda k=k: (_slowly(k), os.getpid())[1] for k in range(COUNT)]))
    for helper in workers - {os.getpid()}:
        with pytest.raises(ProcessLookupError):
            os.kill(helper, 0)
