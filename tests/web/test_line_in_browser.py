"""The page of a line in a real browser, as an operator uses it; runs at paced simulated stations.

Few are for make test: every process of it that takes one starts a server and a browser of its own.
"""

import re
import signal

import pytest
from axe_core_python.sync_playwright import Axe
from playwright.sync_api import expect
from served_line import PIN

expect.set_options(timeout=40_000)  # a run's process loads for seconds, on a busy computer for many

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of the browser's driver


def _scan(page, serial, recipe):
    """Type as a scanner does, and start with the keyboard alone."""
    page.locator("#recipe").select_option(recipe)
    page.locator("#serial").focus()
    page.keyboard.type(serial)
    page.keyboard.press("Enter")
    expect(page.locator("#gate button")).to_be_focused()
    page.keyboard.press("Enter")


def _shows(page, state):
    expect(page.locator("#state")).to_contain_text(state)


def _accessible(page):
    found = Axe().run(page, options={"resultTypes": ["violations"]})["violations"]
    assert not found, [(one["id"], [node["html"][:120] for node in one["nodes"]]) for one in found]


@pytest.mark.rest
def test_a_sensor_is_tested_by_keyboard_from_scan_to_verdict(line, pages):
    page = pages("/stations/bench-1")
    page.shot("ready")
    _accessible(page)
    expect(page.locator("#serial")).to_be_focused()
    _scan(page, "KEY-1", "five-places")
    _shows(page, "Running")
    page.get_by_role("button", name="Pause").focus()
    page.keyboard.type("KEY-9")
    page.keyboard.press("Enter")
    expect(page.locator("#say")).to_contain_text("That scan was ignored")
    viewer = pages("/stations/bench-1")  # somebody opens the page in the middle
    expect(viewer.locator("#image")).to_have_attribute("href", re.compile("/image/.+/[0-9]+$"))
    expect(viewer.locator("circle.head")).to_be_visible()
    expect(viewer.locator(".places li.running")).to_contain_text("now")
    expect(viewer.locator(".places small", has_text="mm off").first).to_be_visible()
    viewer.shot("running")
    _accessible(viewer)
    expect(page.locator(".verdict")).to_contain_text("Passed")
    expect(page.locator(".verdict")).to_contain_text("KEY-1")
    expect(page.locator(".verdict .reason")).to_contain_text("limits are met")
    expect(viewer.locator(".verdict h2")).to_contain_text("Passed")
    page.shot("verdict-passed")
    _accessible(page)
    with page.context.expect_page() as opened:
        page.get_by_role("link", name="Report").click()
    expect(opened.value.locator("h1")).to_contain_text("KEY-1")
    # The verdict stays over a reload, and goes when the next sensor is scanned.
    page.reload()
    expect(page.locator(".verdict h2")).to_contain_text("Passed")
    page.locator("#content").focus()
    page.keyboard.type("KEY-2")
    page.keyboard.press("Enter")
    expect(page.locator("#gate")).to_contain_text("KEY-2")
    expect(page.locator(".verdict")).to_have_count(0)
    # Another scan is of another sensor, wherever the focus is, and starts nothing.
    expect(page.get_by_role("button", name="Start KEY-2")).to_be_focused()
    page.keyboard.type("KEY-3")
    page.keyboard.press("Enter")
    expect(page.get_by_role("button", name="Start KEY-3")).to_be_focused()
    _shows(page, "Ready")
    page.shot("gate")
    _accessible(page)


@pytest.mark.rest
def test_prompts_pauses_a_dead_page_a_killed_run_and_a_stop(line, pages):
    page, other = pages("/stations/bench-2"), pages("/stations/bench-2")
    _scan(page, "ASK-1", "asking")
    for viewer in (page, other):
        expect(viewer.locator("#prompt-text")).to_have_text("Wipe the sheet <b>dry</b>. Is there dust on it?")
    expect(page.locator("#answer")).to_be_focused()
    page.shot("prompt")
    _accessible(page)
    page.keyboard.type("No <i>dust</i>")
    number = page.locator("[name=prompt]").get_attribute("value")
    page.keyboard.press("Enter")
    for viewer in (page, other):
        expect(viewer.locator("#prompt-text")).to_have_text("Close the cover.")
        expect(viewer.get_by_role("img", name="Picture for this question")).to_have_js_property("naturalWidth", 40)
    late = other.request.post(
        "/stations/bench-2/answer", form={"prompt": number, "text": "late"}, headers={"origin": line.address}
    )
    assert late.ok
    assert late.json()["words"] != "The answer was accepted."
    other.get_by_role("button", name="Answer").click()
    _shows(page, "Running")
    page.get_by_role("button", name="Pause").click()
    _shows(other, "Paused")
    expect(other.locator("#controls")).to_contain_text("The head is up")
    other.shot("paused")

    line.stop(signal.SIGKILL)
    expect(page.locator("#connection")).to_contain_text("Runs continue")
    other.get_by_role("button", name="Continue").click()
    expect(other.locator("#say")).to_contain_text("Not sent: the server does not answer. Nothing was changed.")
    page.get_by_role("button", name="Emergency stop").click()
    expect(page.locator("#say")).to_contain_text("NOT sent")
    page.shot("connection-lost")
    line.start()
    expect(page.locator("#connection")).to_be_empty()
    other.reload()
    _shows(other, "Paused")
    other.get_by_role("button", name="Continue").click()
    _shows(page, "Running")

    line.kill_run("bench-2")
    _shows(page, "Interrupted")
    expect(page.locator(".verdict")).to_contain_text("Check the bench first")
    page.keyboard.type("NEXT-1")
    page.keyboard.press("Enter")
    expect(page.get_by_role("button", name="Start NEXT-1")).to_be_visible()
    expect(page.locator(".verdict")).to_contain_text("Check the bench first")
    page.shot("interrupted")
    _accessible(page)
    page.get_by_role("button", name="Resume the run").click()
    _shows(page, "Running")
    page.get_by_role("button", name="Stop", exact=True).click()
    expect(page.get_by_role("button", name="Stop the run")).to_be_focused()
    page.shot("stop-asked")
    page.keyboard.press("Enter")
    expect(page.locator(".verdict h2")).to_contain_text("Stopped")
    page.shot("stopped")
    page.get_by_role("button", name="Resume the run").click()
    _shows(page, "Running")
    page.get_by_role("button", name="Emergency stop").click()
    expect(page.locator("#say")).to_contain_text("Emergency stop sent.")
    expect(page.locator(".verdict .reason")).to_contain_text("by an emergency stop by a viewer of the page")
    page.shot("emergency-stopped")


@pytest.mark.rest
def test_an_instrument_that_dies_is_named_with_what_to_do(pages):
    page = pages("/stations/dying")
    page.locator("#operator").fill("Ada")
    page.locator("#recipe").select_option("five-places")
    page.locator("#serial").fill("DIE-1")
    page.keyboard.press("Enter")
    expect(page.get_by_label("PIN of Ada")).to_be_focused()
    page.keyboard.type("4712")
    page.keyboard.press("Enter")
    expect(page.locator("#gate .refused")).to_contain_text("the PIN given is not that of Ada")
    expect(page.get_by_label("PIN of Ada")).to_be_focused()
    _accessible(page)
    page.keyboard.type(PIN)
    page.keyboard.press("Enter")
    _shows(page, "Running")
    expect(page.locator("#trouble")).to_contain_text(re.compile("No frame for [2-4] s. Look at the station"))
    page.shot("no-frame")
    expect(page.locator(".verdict h2")).to_contain_text("Stopped by a fault")
    expect(page.locator(".verdict .reason")).to_contain_text("its cable was pulled out")
    expect(page.locator(".todo")).to_contain_text("Check the bench first")
    page.shot("broken-off")
    page.get_by_label("PIN (if you have one)").fill("4712")
    page.get_by_role("button", name="Resume the run").click()
    expect(page.locator("#say")).to_contain_text("The PIN given is not that of Ada: the run was not resumed")
    overview = pages("/")
    expect(overview.locator(".card").nth(2)).to_contain_text("Stopped by a fault")
    overview.shot("overview")
    _accessible(overview)
    shift = pages("/shift")
    expect(shift.locator("tbody").last).to_contain_text("DIE-1")
    shift.shot("shift")
    _accessible(shift)
    shift.get_by_role("link", name="DIE-1").click()
    expect(shift.locator("h1")).to_contain_text("DIE-1")
    shift.shot("sensor")
    _accessible(shift)


@pytest.mark.parametrize("serial", ["<script>alert(1)</script>", "Y" * 65])
def test_a_hostile_serial_is_refused_with_what_is_allowed(pages, serial):
    page = pages("/stations/bench-1")
    page.locator("#serial").fill(serial)
    page.keyboard.press("Enter")
    expect(page.locator("#say")).to_contain_text("cannot be used")
    expect(page.locator("#gate")).to_be_empty()


def test_the_gate_refuses_until_somebody_overrides_it(pages):
    page = pages("/stations/dying")
    page.locator("#operator").fill("Nobody")
    page.locator("#serial").fill("GATE-1")
    page.keyboard.press("Enter")
    expect(page.locator("#gate .refused")).to_contain_text("operator")
    expect(page.get_by_role("button", name="Start")).to_have_count(0)
    page.shot("gate-refuses")
    _accessible(page)
    page.get_by_text("Override with a name and a reason").click()
    page.get_by_label("Who decides").fill("Grace")
    page.get_by_label("Why").fill("Ada is ill")
    page.keyboard.press("Enter")
    expect(page.locator("#gate .overridden")).to_contain_text("overridden by Grace: Ada is ill")
    expect(page.get_by_role("button", name="Start")).to_be_focused()
    page.shot("gate-overridden")
    _accessible(page)


@pytest.mark.rest
def test_who_is_not_signed_in_is_asked_to(line, chromium, pages):
    with chromium.new_context(base_url=line.address) as stranger:
        page = stranger.new_page()
        assert page.goto("/stations/bench-1").status == 401
        page.get_by_label("Token").fill("wrong")
        page.keyboard.press("Enter")
        expect(page.get_by_role("alert")).to_contain_text("not the token")
        _accessible(page)


@pytest.mark.rest
def test_pages_fit_a_tablet_and_a_zoomed_screen(pages):
    page = pages("/stations/bench-1")
    for name, width, height in (("tablet", 768, 1024), ("zoom-200", 640, 400)):
        page.set_viewport_size({"width": width, "height": height})
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        page.shot(f"verdict-{name}")
