"""Who shows the token is read before strangers, who are read in turn."""

import asyncio

import pytest

from cbsr_qa.web.connection_limits import MAX_NEW, MAX_OPEN, ConnectionLimiter
from cbsr_qa.web.guard import Access, Right
from tests.samples.loops import run_coroutine

_TOKEN = "token-of-these-tests-only"
_ACCESS = Access(frozenset({"here"}), "http", _TOKEN, False, 8765, "key-of-cookies", frozenset())


@pytest.mark.parametrize(
    ("said", "shown"),
    [
        (f"POST / HTTP/1.1\r\nAuthorization: Bearer {_TOKEN}\r\n", True),
        (f"POST / HTTP/1.1\r\nauthorization: bearer  {_TOKEN}\r\n", True),
        (f"GET /?token={_TOKEN} HTTP/1.1\r\n", True),
        (f"GET / HTTP/1.1\r\nCookie: other=1; cbsr_qa_8765={_ACCESS.cookie_value}\r\n", True),
        (f"GET / HTTP/1.1\r\nCookie: cbsr_qa_8765={_TOKEN}-of-others\r\n", False),
        (f"POST / HTTP/1.1\r\nAuthorization: Bearer {_TOKEN[:-1]}\r\n", False),
        (f"GET /{_TOKEN} HTTP/1.1\r\n", False),
        ("Authorization: Bearer \r\n" * 9 + "token=" * 99, False),
    ],
)
def test_the_token_is_seen_in_each_form_that_counts(said, shown):
    assert _ACCESS.is_shown_in(said.encode()) is shown


class _Connection:
    right, is_answering, client_name = Right.NONE, False, "127.0.0.1"

    def __init__(self, opened_s=0.0, checks=0):
        self.opened_s, self.checks = opened_s, checks
        self.reads, self.is_closed = 0, False

    def read_received(self):
        self.reads += 1

    def abort(self):
        self.is_closed = True


def test_between_two_rounds_of_the_loop_only_some_strangers_are_read():
    async def rounds():
        strangers, waiting, read = ConnectionLimiter(lambda said: False), [_Connection() for _ in range(40)], []
        for one in waiting:
            strangers.queue_read(one)
        while sum(read) < len(waiting):
            before = sum(one.reads for one in waiting)
            await asyncio.sleep(0)
            read.append(sum(one.reads for one in waiting) - before)
        assert [one.reads for one in waiting] == [1] * 40
        return read

    assert max(run_coroutine(rounds())) <= 8


def test_new_connections_stay_and_the_oldest_of_the_others_are_closed():
    old = [_Connection(opened_s=n, checks=9) for n in range(100)]
    new = [_Connection(opened_s=100 + n) for n in range(20)]
    ConnectionLimiter(lambda said: False).close_surplus([*new, *old])
    assert [one.is_closed for one in old] == [True] * (120 - MAX_OPEN[Right.NONE]) + [False] * 44
    assert not any(one.is_closed for one in new)


def test_too_many_new_connections_are_closed():
    new = [_Connection(opened_s=n) for n in range(MAX_NEW + 5)]
    ConnectionLimiter(lambda said: False).close_surplus(new)
    assert [one.is_closed for one in new] == [True] * 5 + [False] * MAX_NEW
