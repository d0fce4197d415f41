"""The form of a station's page in a real browser: who works there, scans into its fields, and changes after a scan.

Nothing is served: the browser's requests are answered here, so that no run and no other test has to be waited for.
"""

from dataclasses import replace
from pathlib import Path
from urllib.parse import parse_qsl, urlsplit

import pytest
from playwright.sync_api import expect
from stored_lots import store_run

from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.store.opening import open_store
from cbsr_qa.web import pages as package
from cbsr_qa.web.line import Line
from cbsr_qa.web.pages import Pages
from cbsr_qa.web.state import Mode, Snapshot
from cbsr_qa.web.stations import load_stations

_STATIC = Path(package.__file__).parent / "static"
_KINDS = {".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}
_ADDRESS = "http://line.test"

pytestmark = [pytest.mark.rest, pytest.mark.filterwarnings("ignore::DeprecationWarning")]  # of the browser's driver
#: Keys of a scanner, all at once: a busy machine may be slow to pass on those of the browser's driver.
_SCAN = """keys => {
    for (const key of [...keys, "Enter"]) {
        const pressed = new KeyboardEvent("keydown", {key, bubbles: true, cancelable: true});
        if (!document.activeElement.dispatchEvent(pressed)) continue;
        const field = document.activeElement;  // that of the key may have led to another
        if (key === "Enter") {
            field.form.requestSubmit();
            continue;
        }
        field.value += key;
        field.dispatchEvent(new InputEvent("input", {bubbles: true}));
    }
}"""


class _Stations:
    """Two stations whose latest run is one of Kim's; keeps what was posted, and answers with what a test sets."""

    def __init__(self, look):
        self.line = Line(load_stations(["line-1", "line-2"], ["nine-locations"]), None)
        self.pages, self.posted, self.answers = Pages(self.line), [], {}
        for name in self.line.stations:
            self.show(name, Mode.DONE, replace(look, operator="Kim"))

    def show(self, name, mode, look):
        """Set what the page of a station shows from now on."""
        snapshot = Snapshot(name, mode, None, look, (), None, None, "", "", "", "", healthy=True)
        self.line.stations[name].snapshot = snapshot
        return snapshot

    def answer(self, route):
        path = urlsplit(route.request.url).path
        if route.request.method == "POST":
            self.posted.append((path, dict(parse_qsl(route.request.post_data, keep_blank_values=True))))
            route.fulfill(json=self.answers.get(path.rpartition("/")[2], {}))
        elif path.startswith("/static/"):
            file = _STATIC / Path(path).name
            route.fulfill(body=file.read_text(), content_type=_KINDS[file.suffix])
        elif path.endswith("/events"):
            route.abort()
        else:
            station = path.rpartition("/")[2]
            body = self.pages.station(station, control=True) if station in self.line.stations else "<p>Overview"
            route.fulfill(body=body, content_type="text/html")


@pytest.fixture(scope="module")
def look(tmp_path_factory):
    with open_store(f"sqlite:///{tmp_path_factory.mktemp('form') / 'runs.db'}", durable=False) as store:
        return store.live.find_run(store_run(store, "S-1", ()))


@pytest.fixture
def stations(look):
    return _Stations(look)


@pytest.fixture
def page(chromium, stations):
    with chromium.new_context(base_url=_ADDRESS) as context:
        context.route("**/*", stations.answer)
        page = context.new_page()
        page.goto("/stations/line-1")
        yield page


def _posted(page, stations, count):
    """Wait until as many forms were posted; return them."""
    while len(stations.posted) < count:
        page.wait_for_timeout(20)
    return stations.posted


def test_the_name_that_was_typed_last_stays_until_another_run_names_its_operator(page, stations, look):
    operator = page.locator("#operator")
    expect(operator).to_have_value("Kim")
    for name in ("Lee", ""):
        operator.fill(name)
        page.goto("/")
        page.goto("/stations/line-1")
        expect(operator).to_have_value(name)
        page.reload()
        expect(operator).to_have_value(name)
        page.goto("/stations/line-2")
        expect(operator).to_have_value("Kim")
        page.goto("/stations/line-1")
    stations.show("line-1", Mode.DONE, replace(look, run="another", operator="Ada"))
    page.reload()
    expect(operator).to_have_value("Ada")


def test_what_is_done_to_a_resumed_run_is_done_by_the_name_that_stood_at_the_station(page, stations, look):
    stations.show("line-1", Mode.DONE, _aborted(replace(look, operator="Lee")))
    page.reload()
    page.get_by_role("button", name="Resume the run of S-5").click()
    assert _posted(page, stations, 1)[0][1]["by"] == "Lee"
    stations.show("line-1", Mode.STARTING, look)
    page.goto("/stations/line-1")
    page.get_by_role("button", name="Cancel the start").click()
    assert _posted(page, stations, 2)[1][1]["by"] == "Lee"


def test_enter_after_the_name_leads_to_the_scan(page, stations):
    page.locator("#operator").fill("Lee")
    page.locator("#operator").press("Enter")
    expect(page.locator("#serial")).to_be_focused()
    assert stations.posted == []


def test_who_confirms_at_one_station_does_nothing_else_there_or_elsewhere(page, stations, look):
    stations.show("line-1", Mode.UNSAFE, look)
    page.reload()
    page.get_by_label("Who confirms").fill("Grace")
    page.get_by_role("button", name="The bench is safe").click()
    path, form = _posted(page, stations, 1)[-1]
    assert (path, form["by"]) == ("/stations/line-1/confirm", "Grace")
    stations.show("line-1", Mode.STARTING, look)
    stations.show("line-2", Mode.STARTING, look)
    for count, station in enumerate(("line-1", "line-2"), start=2):
        page.goto(f"/stations/{station}")
        page.get_by_role("button", name="Cancel the start").click()
        path, form = _posted(page, stations, count)[-1]
        assert (path, form["by"]) == (f"/stations/{station}/cancel", "")
        expect(page.locator("[aria-busy]")).to_have_count(0)
        expect(page.locator("#say")).to_be_empty()


def test_enter_in_the_name_of_who_confirms_confirms_nothing(page, stations, look):
    stations.show("line-1", Mode.UNSAFE, look)
    page.reload()
    page.get_by_label("Who confirms").fill("Grace")
    page.get_by_label("Who confirms").press("Enter")
    page.wait_for_timeout(100)
    assert stations.posted == []
    page.get_by_role("button", name="The bench is safe").press("Enter")
    assert _posted(page, stations, 1)[0][1]["by"] == "Grace"


def _scanned(stations, serial):
    """The answer to a check of a sensor with a field that is wrong."""
    return {"parts": [["gate", stations.pages.render_wrong_field("line-1", serial, "parts")], ["verdict", ""]]}


def test_a_field_is_checked_when_it_is_left_and_its_error_goes_with_the_next_key(page, stations):
    stations.answers["check"] = {**_scanned(stations, "S-6"), "wrong": {"parts": "part 'she' has no ="}}
    page.locator("#serial").fill("S-6")
    page.locator("#serial").press("Enter")
    _posted(page, stations, 1)
    wrong, parts = page.locator("#parts-wrong"), page.locator("#parts")
    expect(wrong).to_have_text("part 'she' has no =")
    expect(page.get_by_role("button", name="Start S-6")).to_be_disabled()
    parts.press_sequentially("sheet", delay=10)
    expect(wrong).to_be_empty()
    assert len(stations.posted) == 1
    stations.answers["check"] = _scanned(stations, "S-6")
    parts.press_sequentially("=LOT7", delay=10)
    parts.press("Tab")
    assert _posted(page, stations, 2)[1][1]["parts"] == "sheet=LOT7"
    expect(wrong).to_be_empty()
    parts.press("x")
    parts.press("Backspace")  # no browser says that this field was changed
    parts.press("Tab")
    _posted(page, stations, 3)


@pytest.mark.parametrize("field", ["operator", "batch", "parts"])
def test_a_scan_into_a_field_for_people_is_a_scan(page, stations, field):
    place = page.locator(f"#{field}")
    place.fill("Lee")
    page.wait_for_timeout(200)  # nobody scans within the same tenth of a second
    page.evaluate(_SCAN, "S-123")
    path, form = _posted(page, stations, 1)[0]
    assert (path, form["serial"], form[field]) == ("/stations/line-1/check", "S-123", "Lee")
    expect(place).to_have_value("Lee")


@pytest.mark.parametrize("left", ["", "strict"])
def test_a_scan_replaces_what_lies_in_the_scan_field(page, stations, left):
    page.locator("#serial").fill(left)
    page.wait_for_timeout(200)
    page.evaluate(_SCAN, "S-123")
    assert _posted(page, stations, 1)[0][1]["serial"] == "S-123"


def test_a_scan_that_begins_outside_of_all_fields_is_whole(page, stations):
    page.locator("#recipe").focus()
    page.wait_for_timeout(200)
    page.evaluate(_SCAN, "S-123")
    assert _posted(page, stations, 1)[0][1]["serial"] == "S-123"


def test_a_part_that_is_scanned_for_a_sensor_leaves_no_half_typed_serial_number(page, stations):
    """The next serial number, typed by hand, once followed the one that lay in the field: "S-6S-7"."""
    stations.answers["check"] = {**_scanned(stations, "S-6"), "fields": {"serial": "S-6", "parts": "sheet=LOT7"}}
    stations.answers["leave"] = {"parts": [["gate", ""]], "fields": {"serial": ""}}
    page.evaluate(_SCAN, "S-6")
    _posted(page, stations, 1)
    page.wait_for_timeout(200)
    page.evaluate(_SCAN, "sheet=LOT7")
    _posted(page, stations, 2)
    expect(page.locator("#parts")).to_have_value("sheet=LOT7")
    page.get_by_role("button", name="No, next sensor").click()
    expect(page.locator("#serial")).to_have_value("")


def test_a_batch_that_was_filled_in_is_stated_once_a_person_changes_it(page, stations):
    stations.answers["check"] = {"fields": {"serial": "S-6", "batch": "B7", "recalled": "B7"}}
    page.locator("#serial").fill("S-6")
    page.locator("#serial").press("Enter")
    _posted(page, stations, 1)
    expect(page.locator("#recalled")).to_have_value("B7")
    page.locator("#batch").press("End")
    page.locator("#batch").press_sequentially("x", delay=10)
    expect(page.locator("#recalled")).to_have_value("")


def test_a_name_that_a_person_types_and_ends_with_enter_is_no_scan(page, stations):
    page.locator("#operator").fill("")
    page.locator("#operator").press_sequentially("Grace", delay=120)
    page.locator("#operator").press("Enter")
    expect(page.locator("#serial")).to_be_focused()
    expect(page.locator("#operator")).to_have_value("Grace")
    assert stations.posted == []


def test_a_scan_into_the_name_of_who_confirms_is_ignored(page, stations, look):
    stations.show("line-1", Mode.UNSAFE, look)
    page.reload()
    page.get_by_label("Who confirms").focus()
    page.evaluate(_SCAN, "S-123")
    expect(page.locator("#say")).to_contain_text("That scan was ignored")
    expect(page.get_by_label("Who confirms")).to_have_value("")
    assert stations.posted == []


def _aborted(look):
    return replace(look, serial="S-5", end=EndReason.ABORTED, outcome=None, detail="by Kim, while")


def test_only_the_action_of_the_sensor_that_was_scanned_is_marked(page, stations, look):
    stations.show("line-1", Mode.DONE, _aborted(look))
    page.reload()
    resume = page.get_by_role("button", name="Resume the run of S-5")
    ground = "one => getComputedStyle(one).backgroundColor"
    assert resume.evaluate(ground) != "rgba(0, 0, 0, 0)"
    stations.answers["check"] = {"parts": _scanned(stations, "S-6")["parts"][:1]}
    page.locator("#serial").fill("S-6")
    page.locator("#serial").press("Enter")
    expect(page.get_by_role("button", name="Start S-6")).to_be_visible()
    assert resume.evaluate(ground) == "rgba(0, 0, 0, 0)"


@pytest.mark.parametrize(("begun", "words"), [("S-7", "Sensor S-6, which was ready to start here"), ("S-6", "")])
def test_a_sensor_that_was_ready_does_not_vanish_without_a_word(page, stations, begun, words, look):
    """Another page started a sensor, or the same one: what a stream sends is put into the page of this one."""
    page.evaluate("""() => {
        class Stream extends EventTarget { constructor() { super(); window.stream = this; } close() {} }
        window.EventSource = Stream;
        dispatchEvent(new Event("pagehide"));
        dispatchEvent(new Event("pageshow"));
    }""")
    stations.answers["check"] = _scanned(stations, "S-6")
    page.locator("#serial").fill("S-6")
    page.locator("#serial").press("Enter")
    expect(page.get_by_role("button", name="Start S-6")).to_be_visible()
    snapshot = stations.show("line-1", Mode.STARTING, look)
    stations.line.stations["line-1"].snapshot = replace(snapshot, starting=begun)
    parts = [[part.place, part.html, part.key] for part in stations.pages.station_parts("line-1")]
    page.evaluate("parts => stream.onmessage({data: JSON.stringify({parts})})", parts)
    expect(page.locator("#state")).to_contain_text(begun)
    expect(page.locator("#say")).to_contain_text(words) if words else expect(page.locator("#say")).to_be_empty()


@pytest.mark.parametrize("width", [768, 1024, 1280, 1920])
def test_a_field_stands_where_it_was_with_and_without_a_verdict_beside_the_form(page, stations, width):
    page.set_viewport_size({"width": width, "height": 800})
    field_ids = ("serial", "recipe", "operator", "batch", "parts")
    places = [page.locator(f"#{name}").bounding_box() for name in field_ids]
    page.locator("#verdict").evaluate("one => { one.innerHTML = ''; }")
    assert [page.locator(f"#{name}").bounding_box() for name in field_ids] == [
        pytest.approx(place, abs=1.0) for place in places
    ]
