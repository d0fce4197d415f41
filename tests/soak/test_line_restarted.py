"""The page restarted a hundred times during a run, and two viewers who answer each question at once."""

import http.client
import json
import os
import random
import re
import signal
import threading
import time
from urllib.parse import urlencode

import pytest
from served_line import TOKEN, ServedLine, until

RESTARTS = int(os.environ.get("CBSR_QA_SOAK_TRIALS", "100"))
SEED = int(os.environ.get("CBSR_QA_SOAK_SEED", "0"))
_SIGNED = {"Content-Type": "application/x-www-form-urlencoded", "Authorization": f"Bearer {TOKEN}"}


@pytest.fixture
def line(tmp_path, monkeypatch):
    line = ServedLine(tmp_path)
    monkeypatch.setenv("CBSR_QA_VAR", str(tmp_path / "var"))
    yield line.start()
    line.stop()


def _ask(line, method, path, **form):
    connection = http.client.HTTPConnection("127.0.0.1", line.port, timeout=10)
    try:
        connection.request(method, path, urlencode(form) if form else None, _SIGNED)
        return connection.getresponse().read().decode()
    finally:
        connection.close()


def _answer_at_once(line, prompt):
    """Answer a prompt from eight threads at the same moment, and return what each is told."""
    barrier, told = threading.Barrier(8), []

    def answer(number):
        barrier.wait()
        words = _ask(line, "POST", "/stations/bench-1/answer", prompt=prompt, text=f"viewer {number}")
        told.append(json.loads(words)["words"])

    viewers = [threading.Thread(target=answer, args=(number,)) for number in range(8)]
    for viewer in viewers:
        viewer.start()
    for viewer in viewers:
        viewer.join()
    return told


def _open_prompt(line):
    """Return the number of the prompt that the page shows; empty without one."""
    page = _ask(line, "GET", "/stations/bench-1")
    return page.partition('name="prompt" value="')[2].partition('"')[0]


def test_a_run_goes_on_through_restarts_of_its_page_and_takes_one_answer_to_each_question(line):
    chance = random.Random(SEED)
    _ask(line, "POST", "/stations/bench-1/start", serial="RESTARTED-1", recipe="asking", operator="Ada")
    until(lambda: line.holder("bench-1"), "the run")
    slowest_s = 0.0
    for number in range(RESTARTS):
        line.stop(chance.choice([signal.SIGTERM, signal.SIGKILL, signal.SIGINT]))
        line.start()
        begun_s = time.monotonic()
        until(lambda: "RESTARTED-1" in _ask(line, "GET", "/stations/bench-1"), "the run on the page")
        slowest_s = max(slowest_s, time.monotonic() - begun_s)
        if number in (RESTARTS // 3, RESTARTS // 2):
            told = _answer_at_once(line, until(lambda: _open_prompt(line), "a question"))
            assert told.count("The answer was accepted.") == 1, told
    assert slowest_s < 5.0  # a page asks for news twice a second; under a second on an idle computer
    until(lambda: line.holder("bench-1") is None, "the end of the run", 300)
    shown = _ask(line, "GET", "/sensors/RESTARTED-1")
    assert re.search(r'class="badge (pass|marginal|fail)"', shown), shown
