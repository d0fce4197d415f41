"""Independent pieces of work, shared with a helper."""

import os
import signal
import time
from pathlib import Path

import pytest

from cbsr_qa.system.beside import Ahead, side_by_side

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


def test_what_was_begun_ahead_is_made_once_by_a_helper_where_there_is_a_processor(processors):
    ahead = Ahead(lambda: (list(range(100_000)), os.getpid()))
    numbers, process = ahead.result()
    assert numbers == list(range(100_000))
    assert (process == os.getpid()) == (processors == 1)
    assert ahead.result() is ahead.result()


def test_a_helper_takes_what_was_begun_ahead_of_it_and_so_does_its_parent(processors):
    first = Ahead(lambda: ("made", os.getpid()))
    second = Ahead(lambda: (first.result(), os.getpid()))
    (found, of_helper), _ = second.result()
    assert (found, of_helper) == first.result()
    assert (of_helper == os.getpid()) == (processors == 1)


def _killed_elsewhere(here):
    if os.getpid() != here:
        os.kill(os.getpid(), signal.SIGKILL)
    return "made here"


@pytest.mark.parametrize(
    "task", [_killed_elsewhere, lambda here: lambda: "made here"], ids=["a killed helper", "what cannot be pickled"]
)
def test_what_a_helper_does_not_return_is_made_here(processors, task):
    here = os.getpid()
    result = Ahead(lambda: task(here)).result()
    assert (result if isinstance(result, str) else result()) == "made here"


def test_an_error_ahead_is_raised_when_the_result_is_asked_for(processors):
    ahead = Ahead(lambda: _raises(ValueError("bad")))
    with pytest.raises(ValueError, match="bad"):
        ahead.result()


def test_what_nobody_asks_for_leaves_no_helper_and_no_file(processors):
    before, others = set(Path("/proc/self/fd").iterdir()), _children()
    ahead = Ahead(lambda: time.sleep(60))
    helpers = _children() - others
    assert len(helpers) == processors - 1
    del ahead
    assert set(Path("/proc/self/fd").iterdir()) == before
    for helper in helpers:
        with pytest.raises(ProcessLookupError):
            os.kill(int(helper), 0)


def _children():
    return set(Path(f"/proc/self/task/{os.getpid()}/children").read_text().split())
