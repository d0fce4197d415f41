"""The page of a line in a real browser, as an operator uses it; runs at paced simulated stations.

Few are for make test: every process of it that takes one starts a server and a browser of its own.
"""

import re
import signal

import pytest
from axe_core_python.sync_playwright import Axe
from playwright.sync_api import expect
from served_line import PIN

expect.set_options(timeout=120_000)  # a run's process loads for seconds, on a busy computer for many

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of the browser's driver


def _scan(page, serial, recipe):
    """Type as a scanner does, and start with the keyboard alone."""
    page.locator("#recipe").select_option(recipe)
    page.locator("#serial").focus()
    page.keyboard.type(serial)
    page.keyboard.press("Enter")
    expect(page.locator("#gate [action$='/start'] button")).to_be_focused()
    page.keyboard.press("Enter")


def _shows(page, state):
    expect(page.locator("#state")).to_contain_text(state)


_SHOWN_SIZES = """() => [...document.querySelectorAll("#state .mode, #state .outcome, #state .serial")].map(
    (one) => [one.textContent.trim(), parseFloat(getComputedStyle(one).fontSize) / innerHeight])"""


#: The head is down for 0.3 s at a time.
_SEE_THE_HEAD = """() => new Promise((seen) => {
    const look = () => document.querySelector("circle.head") ? seen() : requestAnimationFrame(look);
    look();
})"""


def _reads_at_three_metres(page, *texts):
    """State, serial number and verdict are across the screen, each at least a fortieth of it high."""
    sizes = dict(page.evaluate(_SHOWN_SIZES))
    assert set(texts) <= set(sizes), (texts, sizes)
    assert min(sizes.values()) >= 0.025, sizes
    assert page.locator("#state .board").bounding_box()["width"] > 0.9 * page.viewport_size["width"]


def _accessible(page):
    found = Axe().run(page, options={"resultTypes": ["violations"]})["violations"]
    assert not found, [(one["id"], [node["html"][:120] for node in one["nodes"]]) for one in found]


@pytest.mark.rest
def test_a_sensor_is_tested_by_keyboard_from_scan_to_verdict(line, pages):
    page = pages("/stations/bench-1")
    page.shot("ready")
    _accessible(page)
    _reads_at_three_metres(page, "Ready")
    expect(page.locator("#serial")).to_be_focused()
    _scan(page, "KEY-1", "five-places")
    _shows(page, "Running")
    _reads_at_three_metres(page, "Running", "KEY-1")
    page.get_by_role("button", name="Pause").focus()
    page.keyboard.type("KEY-9")
    page.keyboard.press("Enter")
    expect(page.locator("#say")).to_contain_text("That scan was ignored")
    viewer = pages("/stations/bench-1")  # somebody opens the page in the middle
    expect(viewer.locator("#image")).to_have_attribute("href", re.compile("/image/.+/[0-9]+$"))
    viewer.evaluate(_SEE_THE_HEAD)
    expect(viewer.locator(".progress")).to_have_text(re.compile("Press [0-9]+ of [0-9]+"))
    expect(viewer.locator("circle.place.running")).to_have_count(1)
    expect(viewer.locator("circle.place.pressed").first).to_be_visible()
    assert not re.search(r"\d mm", viewer.locator("main").inner_text()), "coordinates are shown on demand"
    viewer.shot("running")
    _accessible(viewer)
    viewer.get_by_text("Details").click()
    expect(viewer.locator(".places small", has_text="mm off").first).to_be_visible()
    viewer.shot("running-details")
    _accessible(viewer)
    expect(page.locator("#state .outcome")).to_have_text("Passed")
    _reads_at_three_metres(page, "Passed", "KEY-1")
    expect(page.locator(".verdict .reason")).to_contain_text("limits are met")
    expect(viewer.locator("#state .outcome")).to_have_text("Passed")
    page.shot("verdict-passed")
    _accessible(page)
    with page.context.expect_page() as opened:
        page.get_by_role("link", name="Report").click()
    expect(opened.value.locator("h1")).to_contain_text("KEY-1")
    # The verdict stays over a reload, and goes when the next sensor is scanned.
    page.reload()
    expect(page.locator("#state .outcome")).to_have_text("Passed")
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
    _shows(page, "Ready to start")
    page.shot("gate")
    _accessible(page)
    _test_again(page, line)


def _test_again(page, line):
    """A sensor that was tested is tested again only by consent, which an Enter of the scanner is not."""
    page.keyboard.type("KEY-1")
    page.keyboard.press("Enter")
    expect(page.locator("#gate-title")).to_have_text(re.compile("Passed with five-places at bench-1, .+ Test again?"))
    _reads_at_three_metres(page, "Test again?", "KEY-1")
    page.shot("again")
    _accessible(page)
    expect(page.get_by_role("button", name="No, next sensor")).to_be_focused()
    page.keyboard.press("Enter")
    expect(page.locator("#gate")).to_be_empty()
    expect(page.locator("#serial")).to_be_focused()
    expect(page.locator("#state .outcome")).to_have_text("Passed")
    form = {"serial": "KEY-1", "recipe": "five-places"}
    answer = page.request.post("/stations/bench-1/start", form=form, headers={"origin": line.address}).json()
    assert "Test again?" in dict(answer["parts"])["gate"]
    assert line.holder("bench-1") is None
    page.goto("/sensors/KEY-1")
    page.get_by_role("link", name="Test KEY-1 again at bench-1").click()
    page.get_by_role("button", name="Test KEY-1 again").click()
    expect(page.locator(".progress")).to_contain_text("Press")
    page.get_by_role("button", name="Stop", exact=True).click()
    page.get_by_role("button", name="Stop the run").click()
    expect(page.locator("#state .outcome")).to_have_text("Stopped")


def _a_limit_is_explained(page):
    """A place of the drawing opens its limit, with a way to its row in the report; a limit marks its place."""
    first, second = page.locator(".failed details").all()
    marks = page.locator("[data-mark]")
    expect(marks).to_have_count(2)
    place = second.get_attribute("data-place")
    mark = page.locator(f"[data-mark='{place}']")
    mark.click()
    expect(second).to_have_attribute("open", "")
    expect(mark).to_have_class("chosen")
    expect(second.locator("dl")).to_contain_text("≥ 99 %")
    expect(second.locator("dl")).to_contain_text(f"{place}, x ")
    page.shot("verdict-explained")
    _accessible(page)
    first.locator("summary").click()
    expect(mark).not_to_have_class("chosen")
    expect(page.locator(".chosen")).to_have_attribute("data-mark", first.get_attribute("data-place"))
    with page.context.expect_page() as opened:
        first.get_by_role("link", name="Show in the report").click()
    expect(
        opened.value.locator("td", has_text=f"area overlap ({first.get_attribute('data-place')})").first
    ).to_be_visible()
    opened.value.close()


@pytest.mark.rest
def test_a_failed_sensor_shows_every_failed_limit_the_worst_first_and_sounds_are_heard_unless_muted(pages):
    page = pages("/stations/bench-1")
    page.evaluate("""() => {
        const Tone = OscillatorNode;
        window.tones = [];
        window.OscillatorNode = class extends Tone {
            constructor(context, options) { super(context, options); tones.push(options.frequency); }
        };
    }""")
    _scan(page, "BAD-1", "strict")
    expect(page.locator("#state .outcome")).to_have_text("Failed")
    # A busy machine may not show the end, whose tone is 660 Hz, before the fail.
    assert [tone for tone in page.evaluate("tones") if tone != 660] == [440, 330, 220]
    _reads_at_three_metres(page, "Failed", "BAD-1")
    limits = page.locator(".failed li")
    expect(limits).to_have_count(2)
    overlaps = [float(re.search(r"is ([\d.]+) %", words)[1]) for words in limits.all_inner_texts()]
    assert overlaps == sorted(overlaps)
    expect(page.locator(".todo")).to_have_text("Put the sensor with those that failed.")
    page.shot("verdict-failed")
    _accessible(page)
    _a_limit_is_explained(page)
    mute = page.get_by_role("button", name="Sound: on")
    mute.click()
    expect(page.get_by_role("button", name="Sound: off")).to_have_attribute("aria-pressed", "true")
    page.keyboard.type("BAD-1")
    page.keyboard.press("Enter")
    expect(page.locator("#gate-title")).to_contain_text("Failed with strict at bench-1")
    assert 220 in page.evaluate("tones")[-1:]
    page.reload()
    page.get_by_role("button", name="Sound: off").click()
    expect(page.get_by_role("button", name="Sound: on")).to_have_attribute("aria-pressed", "false")


_SLOW_CHECKS = """() => {
    const sent = fetch;
    window.fetch = async (...what) => { await new Promise((end) => setTimeout(end, 1500)); return sent(...what); };
}"""


def test_keys_that_come_before_the_check_answered_are_kept(pages):
    page = pages("/stations/dying")
    page.evaluate(_SLOW_CHECKS)
    page.locator("#operator").fill("Ada")
    page.locator("#serial").focus()
    page.keyboard.type("EARLY-1")
    page.keyboard.press("Enter")
    page.keyboard.type("EARLY-2")  # a scanner's: another sensor
    page.keyboard.press("Enter")
    page.keyboard.type("4711", delay=120)  # a person's: the PIN that will be asked for
    expect(page.get_by_label("PIN of Ada")).to_be_focused()
    expect(page.get_by_label("PIN of Ada")).to_have_value("4711")
    expect(page.locator("#gate")).to_contain_text("Sensor EARLY-2 can be tested")


def test_a_badge_names_the_operator_a_part_is_added_and_what_nobody_knows_loses_nothing(pages):
    page = pages("/stations/dying")
    page.locator("#serial").focus()
    page.keyboard.type("Ada")
    page.keyboard.press("Enter")
    expect(page.locator("#operator")).to_have_value("Ada")
    expect(page.locator("#serial")).to_be_empty()
    expect(page.locator("#serial")).to_be_focused()
    for part in ("sheet=LOT7/B", "board=12"):
        page.keyboard.type(part)
        page.keyboard.press("Enter")
        expect(page.locator("#say")).to_contain_text(f"Part: {part}.")
    page.keyboard.type("sheet=LOT8")
    page.keyboard.press("Enter")
    expect(page.locator("#say")).to_contain_text("part sheet is given twice: sheet=LOT7/B and sheet=LOT8")
    expect(page.locator("#parts")).to_have_value("board=12, sheet=LOT7/B")
    page.locator("#operator").fill("Eve")
    page.locator("#serial").fill("BADGE-1")
    page.keyboard.press("Enter")
    expect(page.locator("#gate .refused")).to_contain_text("Eve is not on the list of operators")
    expect(page.locator("#gate .facts")).to_contain_text("parts board=12, sheet=LOT7/B")
    expect(page.locator("#serial")).to_have_value("BADGE-1")


def test_what_is_changed_after_the_scan_counts(pages):
    """The sensor is checked again once the field is left; until then it cannot be started."""
    page = pages("/stations/bench-1")
    start, facts = page.locator("#gate [action$='/start'] button"), page.locator("#gate .facts").first
    page.locator("#recipe").select_option("five-places")
    page.locator("#serial").fill("LATE-1")
    page.keyboard.press("Enter")
    expect(facts).to_contain_text("parts not given · recipe five-places")
    page.locator("#operator").focus()
    page.keyboard.type("Kim")
    expect(start).to_be_disabled()
    page.keyboard.press("Tab")
    expect(facts).to_contain_text("operator Kim")
    expect(page.locator("#batch")).to_be_focused()
    page.locator("#recipe").select_option("strict")
    expect(facts).to_contain_text("recipe strict · operator Kim")
    page.locator("#serial").focus()
    page.keyboard.type("sheet=LOT7/B")
    page.keyboard.press("Enter")
    expect(facts).to_contain_text("parts sheet=LOT7/B · recipe strict · operator Kim")
    expect(page.locator("#serial")).to_have_value("LATE-1")
    expect(start).to_be_enabled()
    page.locator("#serial").fill("LATE-2")
    page.keyboard.press("Enter")
    expect(page.locator("#gate")).to_contain_text("Sensor LATE-2 can be tested")
    expect(facts).to_contain_text("parts not given")  # they were those of the other sensor


def test_a_scan_that_is_refused_leaves_nothing_ready(pages):
    page = pages("/stations/bench-1")
    page.locator("#serial").fill("FINE-1")
    page.keyboard.press("Enter")
    _shows(page, "Ready to start")
    page.locator("#serial").fill("not fine")
    page.keyboard.press("Enter")
    expect(page.locator("#say.refused")).to_contain_text("cannot be used")
    expect(page.locator("#gate")).to_be_empty()
    expect(page.locator("#state")).not_to_contain_text("Ready to start")


@pytest.mark.rest
def test_prompts_pauses_a_dead_page_a_killed_run_and_a_stop(line, pages):
    page, other = pages("/stations/bench-2"), pages("/stations/bench-2")
    page.locator("#operator").fill("Ada")
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
    _shows(page, "Paused")
    expect(page.locator("#say")).to_be_empty()
    expect(other.locator("#controls")).to_contain_text("Paused by Ada. The head is up")
    other.shot("paused")
    _accessible(other)

    line.stop(signal.SIGKILL)
    expect(page.locator("#connection")).to_contain_text("Runs continue")
    other.get_by_role("button", name="Continue").click()
    expect(other.locator("#say")).to_contain_text("Not sent: the server does not answer. Nothing was changed.")
    page.get_by_role("button", name="Emergency stop").click()
    expect(page.locator("#say")).to_contain_text("NOT sent")
    page.shot("connection-lost")
    line.start()
    for viewer in (page, other):  # both are back by themselves, with what they showed
        expect(viewer.locator("#connection")).to_be_empty()
        _shows(viewer, "Paused")
    other.get_by_role("button", name="Continue").click()
    _shows(page, "Running")

    line.kill_run("bench-2")
    _shows(page, "Interrupted")
    expect(page.locator(".verdict")).to_contain_text("Look before you touch")
    page.keyboard.type("NEXT-1")
    page.keyboard.press("Enter")
    expect(page.get_by_role("button", name="Start NEXT-1")).to_be_visible()
    expect(page.locator(".verdict")).to_contain_text("Look before you touch")
    page.shot("interrupted")
    _accessible(page)
    page.get_by_role("button", name="Resume the run").click()
    _shows(page, "Running")
    page.get_by_role("button", name="Stop", exact=True).click()
    expect(page.get_by_role("button", name="Stop the run")).to_be_focused()
    page.shot("stop-asked")
    page.keyboard.press("Enter")
    expect(page.locator("#state .outcome")).to_have_text("Stopped")
    expect(page.locator(".verdict .reason")).to_have_text("Stopped by Ada.")
    expect(page.locator(".todo")).not_to_contain_text("emergency")
    _reads_at_three_metres(page, "Stopped", "ASK-1")
    page.shot("stopped")
    page.get_by_role("link", name="All runs of ASK-1").click()
    expect(page.get_by_role("link", name="Test ASK-1 again at bench-1")).to_be_visible()
    _accessible(page)
    page.locator("td a[href^='/runs/']").first.click()
    _accessible(page)
    page.get_by_role("link", name="Resume ASK-1 at bench-2").click()
    page.get_by_role("button", name="Resume the run").click()
    expect(page.locator(".progress")).to_contain_text("Press")
    page.get_by_role("button", name="Emergency stop").click()
    assert page.locator("#state .board.emergency").count() == 1, "red at once, before anything answers"
    expect(page.locator("#state .outcome")).to_have_text("Emergency stop")
    expect(page.locator(".verdict .reason")).to_have_text("Stopped by an emergency stop by Ada.")
    _reads_at_three_metres(page, "Emergency stop", "ASK-1", "Check the bench")
    page.shot("emergency-stopped")
    _accessible(page)
    # Nothing starts before somebody says that the bench is safe, whatever page asks for it.
    expect(page.locator("#serial")).to_have_count(0)
    form = {"serial": "NEXT-2", "recipe": "five-places"}
    refused = page.request.post("/stations/bench-2/start", form=form, headers={"origin": line.address})
    assert "First somebody has to confirm" in refused.json()["words"]
    expect(page.get_by_label("Who confirms")).to_have_value("Ada")
    page.get_by_role("button", name="The bench is safe").click()
    expect(page.get_by_role("button", name="Resume the run")).to_be_visible()
    _shows(page, "Ready")
    page.shot("confirmed")


@pytest.mark.rest
def test_a_start_is_cancelled_before_a_run_has_begun(line, pages):
    page = pages("/stations/bench-1")
    _scan(page, "NOT-1", "five-places")
    page.get_by_role("button", name="Cancel the start").click()
    expect(page.locator("#refused")).to_contain_text("Its start was cancelled by")
    page.shot("cancelled")
    assert line.holder("bench-1") is None
    page.goto("/search?q=NOT-1")
    expect(page.locator("h1")).to_contain_text("No sensor, part, batch or operator NOT-1")


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
    expect(page.locator("#state .outcome")).to_have_text("Stopped by a fault")
    expect(page.locator(".verdict .reason")).to_contain_text("its cable was pulled out")
    expect(page.locator(".todo")).to_contain_text("Look before you touch")
    page.shot("broken-off")
    page.get_by_role("button", name="The bench is safe").click()
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
    shift.get_by_role("link", name="DIE-1").first.click()
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
    for name, width, height in (("wide", 1024, 768), ("tablet", 768, 1024), ("zoom-200", 640, 400)):
        page.set_viewport_size({"width": width, "height": height})
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        page.shot(f"verdict-{name}")
