"""Whoever may only look has a thread of its own for pages that take long: it takes none of those who control."""

import asyncio
import threading
from types import SimpleNamespace

import pytest
from starlette.exceptions import HTTPException

from cbsr_qa.web import application
from cbsr_qa.web.guard import Right
from tests.samples.loops import run_coroutine


def _request(right):
    return SimpleNamespace(scope={"cbsr_right": right})


def test_lookers_wait_for_each_other_not_more_than_a_few_and_never_keep_a_controller_waiting():
    async def ask():
        site = application.Site(None, None, None)
        may_end, running = threading.Event(), []

        def make():
            running.append(threading.current_thread())
            assert may_end.wait(20)
            return "page"

        lookers = [
            asyncio.create_task(site._run_in_thread(_request(Right.LOOK), make))
            for _ in range(application._LOOKER_THREADS + application._MAX_WAITING)
        ]
        try:
            await asyncio.sleep(0.5)
            assert len(running) == application._LOOKER_THREADS
            with pytest.raises(HTTPException) as refused:
                await site._run_in_thread(_request(Right.LOOK), make)
            assert refused.value.status_code == 503
            control = site._run_in_thread(_request(Right.CONTROL), lambda: "theirs")
            assert await asyncio.wait_for(control, 10) == "theirs"
        finally:
            may_end.set()
        assert await asyncio.gather(*lookers) == ["page"] * len(lookers)

    run_coroutine(ask())
