"""The pages of a shift and of a search, as somebody who takes over sees them: nothing cut, nothing needs a script."""

import http.client
import json
import threading
import time
from datetime import UTC, datetime, timedelta
from html.parser import HTMLParser

import pytest
import uvicorn
from axe_core_python.sync_playwright import Axe
from playwright.sync_api import expect
from stored_lots import LIMITS, PHASE, store_run

from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.store.opening import open_store
from cbsr_qa.web.application import make_application
from cbsr_qa.web.guard import Access
from cbsr_qa.web.line import Line
from cbsr_qa.web.pages import Pages
from cbsr_qa.web.shift import search_page, sensor_page, shift_page

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of the browser's driver

TOKEN = "token-of-these-tests-only"
CODES = {
    "centre_of_mass_error": {"code": "P2", "text": "a load is <imaged> too large", "disposition": "retest & weigh"}
}
HOSTILE = "<script>alert(1)</script>"


def values(error_mm, drift=0.0):
    place = Measurement("centre_of_mass_error", error_mm, "mm", 0.02, PHASE, "L0", 0, load=0, strain=0.2)
    return tuple(m.judge(LIMITS[m.name]) for m in (place, Measurement("drift", drift, "%/min", how="no frame")))


@pytest.fixture(scope="module")
def shift(tmp_path_factory):
    """Two passed, one after a failed test, one failed twice, one was stopped, one runs; address and runs."""
    url = f"sqlite:///{tmp_path_factory.mktemp('shift') / 'runs.db'}"
    lot, coded = {"parts": ["sheet=LOT7/B", f"board={HOSTILE}"]}, {"tables": {"failure_codes": CODES}}
    with open_store(url, durable=False) as store:
        runs = [
            store_run(store, "S-0501", values(2.0), station="line-1", operator="Kim", **lot),
            store_run(store, "S-0503-WITH-A-VERY-LONG-SERIAL-NUMBER", values(9.0), station="line-2", **coded, **lot),
            store_run(store, "S-0502", values(9.0), station="line-1"),
            store_run(store, "S-0503-WITH-A-VERY-LONG-SERIAL-NUMBER", values(8.0), station="line-2", **coded, **lot),
            store_run(store, "S-0502", values(2.0), station="line-1"),
            store_run(store, "S-0504", values(2.0), station="line-1", end=EndReason.ABORTED),
            store_run(store, "S-0506", values(2.0), station="line-2", end=EndReason.BROKEN),
        ]
    return url, runs


@pytest.fixture(autouse=True)
def day(monkeypatch):
    """The day of the stored runs."""
    begins = datetime(2026, 11, 21, tzinfo=UTC)
    monkeypatch.setattr("cbsr_qa.app.shift.summary.local_day", lambda: (begins, begins + timedelta(days=1)))


def read(html):
    """The text of a page in one line."""
    words = []
    parser = HTMLParser()
    parser.handle_data = words.append
    parser.feed(html)
    return " ".join(" ".join(words).split())


def test_the_shift_is_handed_over_in_a_sentence_with_what_to_do(shift):
    url, runs = shift
    view = shift_page(url, ("line-1", "line-2"), frozenset(runs[-1:]))
    page = Pages(Line((), url)).page("shift", control=True, here="shift", **view)
    words = read(page)
    assert "4 sensors were tested: 2 passed, 1 failed, 1 without a verdict; 1 is still running." in words
    assert (
        " Failed: S-0503-WITH-A-VERY-LONG-SERIAL-NUMBER P2: retest & weigh (it has failed 2 times with P2)." in words
    )
    assert "Today, 2026-11-21 (" in words
    failed = words.partition("Failed sensors")[2].partition("Sensors without a verdict")[0]
    assert "P2 a load is <imaged> too large" in failed
    assert "Retest & weigh (it has failed 2 times with P2)." in failed
    assert "centre of mass error (L0) is 8 mm" in failed
    assert "2 line-2" in failed  # number of tests, station
    stations = words.partition("Tests Passed Failed No verdict Still running")[2]
    assert stations.strip().startswith("line-1 4 2 1 1 0 line-2 3 0 2 0 1")
    assert "centre of mass error, in phase nine locations" in words
    assert HOSTILE not in page


@pytest.mark.parametrize(
    ("wanted", "says"),
    [
        ("sheet=LOT7", "sheet=LOT7: 2 sensors"),
        ("S-0502", "S-0502: 1 sensor"),
        ("lot8", "Did you mean LOT7"),
        ("", "Search for a serial number"),
        (f"{HOSTILE}\x00", "cannot be a stored name"),
    ],
)
def test_a_search_says_what_it_found(shift, wanted, says):
    url, _ = shift
    page = Pages(Line((), url)).page("search", control=True, **search_page(url, wanted))
    assert says in read(page)
    assert HOSTILE not in page


def test_parts_lead_to_the_sensors_that_have_them(shift):
    url, _ = shift
    page = Pages(Line((), url)).page("sensor", control=True, **sensor_page(url, "S-0501"))
    assert 'href="/search?q=sheet%3DLOT7/B"' in page
    assert 'href="/search?q=board%3D%3Cscript%3Ealert%281%29%3C/script%3E"' in page


@pytest.fixture(scope="module")
def served(shift):
    """The pages at an address of their own, signed in with a token."""
    server = uvicorn.Server(uvicorn.Config(lambda: None, host="127.0.0.1", port=0, log_level="error"))
    config = server.config
    sockets = [config.bind_socket()]
    port = sockets[0].getsockname()[1]
    hosts = frozenset({f"127.0.0.1:{port}"})
    access = Access(hosts, "http", TOKEN, False, port, "k" * 32, frozenset())
    config.app = make_application(Line((), shift[0]), access)
    thread = threading.Thread(target=server.run, kwargs={"sockets": sockets}, daemon=True)
    thread.start()
    ends_s = time.monotonic() + 30
    while not server.started and time.monotonic() < ends_s:
        time.sleep(0.05)
    yield port
    server.should_exit = True
    thread.join(20)


def ask(port, path, **headers):
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=30)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    words = answer.read().decode()
    connection.close()
    return answer.status, words


def test_a_search_needs_the_token_as_every_page_does(served):
    path = "/search?q=sheet%3DLOT7"
    status, words = ask(served, path)
    assert (status, "S-0501" in words, "Token of this line" in words) == (401, False, True)
    status, words = ask(served, path, Authorization=f"Bearer {TOKEN}")
    assert (status, "S-0501" in words) == (200, True)
    assert ask(served, "/search?q=%00%ff", Authorization=f"Bearer {TOKEN}")[0] == 400


CUT = """() => [...document.querySelectorAll(".table")].filter((one) => one.scrollWidth > one.clientWidth).length
    + (document.documentElement.scrollWidth > innerWidth)"""
BROKEN_DATES = (
    """() => [...document.querySelectorAll(".whole")].filter((one) => one.getClientRects().length > 1).length"""
)


@pytest.mark.rest
@pytest.mark.parametrize("size", [(1280, 800), (1024, 768), (768, 1024)])
def test_pages_fit_screens_and_tablets_and_are_accessible(served, chromium, size, tmp_path):
    context = chromium.new_context(
        viewport={"width": size[0], "height": size[1]},
        base_url=f"http://127.0.0.1:{served}",
        java_script_enabled=True,
    )
    page = context.new_page()
    page.goto(f"/?token={TOKEN}")
    for path in ("/shift", "/sensors/S-0501", "/search?q=LOT7", "/search?q=lot8", "/search?q=%00"):
        page.goto(path)
        assert page.evaluate(CUT) == 0, path
        assert page.evaluate(BROKEN_DATES) == 0, path
        found = Axe().run(page, options={"resultTypes": ["violations"]})["violations"]
        assert not found, (path, json.dumps([(one["id"], one["nodes"][0]["html"]) for one in found]))
    context.close()


@pytest.mark.rest
def test_a_lot_is_found_without_a_script(served, chromium):
    context = chromium.new_context(base_url=f"http://127.0.0.1:{served}", java_script_enabled=False)
    page = context.new_page()
    page.goto(f"/shift?token={TOKEN}")
    page.get_by_role("searchbox").fill("LOT7")
    page.keyboard.press("Enter")
    expect(page.locator("h1")).to_have_text("LOT7: 2 sensors")
    page.get_by_role("link", name="S-0501").click()
    page.get_by_role("link", name="sheet=LOT7/B").click()
    expect(page.locator("h1")).to_have_text("sheet=LOT7/B: 2 sensors")
    context.close()
