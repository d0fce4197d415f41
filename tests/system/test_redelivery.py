"""A Ctrl-C that comes while Python drops exceptions is not lost."""

import os
import signal
import time
import weakref

import pytest
from stopping import Handle, dropped

from cbsr_qa.system.redelivery import Redelivery


def in_del(number):
    """The same within ``__del__``."""

    class Ending:
        def __del__(self):
            os.kill(os.getpid(), number)
            time.sleep(0)

    Ending()
    time.sleep(5.0)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_without_it_the_interrupt_is_lost():
    dropped(signal.SIGINT, for_s=0.1)


@pytest.mark.parametrize("lose", [lambda number: dropped(number, for_s=5.0), in_del])
def test_a_dropped_interrupt_comes_again(lose):
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt), Redelivery():
        lose(signal.SIGINT)
    assert time.monotonic() - began < 4.0


def test_one_that_is_still_due_at_the_end_is_raised_there():
    with pytest.raises(KeyboardInterrupt), Redelivery():
        dropped(signal.SIGINT)


def test_it_comes_again_once_and_other_dropped_errors_go_where_they_went(monkeypatch):
    lost = []
    monkeypatch.setattr("sys.unraisablehook", lost.append)
    with pytest.raises(KeyboardInterrupt), Redelivery():
        dropped(signal.SIGINT, for_s=5.0)
    time.sleep(0.1)
    with Redelivery():
        handle = Handle()
        kept = weakref.ref(handle, lambda _: {}["nothing"])
        del handle
    assert kept() is None
    assert [one.exc_type for one in lost] == [KeyError]
