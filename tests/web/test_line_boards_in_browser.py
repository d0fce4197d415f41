"""State, serial number and verdict of a station in every state: where they stand, and how large they are."""

import os
import re
from dataclasses import replace
from pathlib import Path

import pytest
from stored_lots import store_run

from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.store.opening import open_store
from cbsr_qa.web import pages
from cbsr_qa.web.line import Line
from cbsr_qa.web.pages import Pages, size_of
from cbsr_qa.web.state import Mode, Snapshot

_CSS = (Path(pages.__file__).parent / "static" / "line.css").read_text()
_ENDS = {
    "aborted": {"end": EndReason.ABORTED, "detail": "by Ada, while"},
    "emergency": {"end": EndReason.ABORTED, "detail": "by an emergency stop by Ada, while"},
    "broken": {"end": EndReason.BROKEN, "detail": "no answer"},
    "interrupted": {"end": EndReason.RUNNING},
    "altered": {"altered": "loads were changed"},
    "none": {"outcome": None},
    **{str(outcome): {"outcome": outcome} for outcome in Outcome},
}
#: What the last run came to, and the state of the station then.
_STATES = [
    *((kind, Mode.DONE) for kind in _ENDS if kind != "interrupted"),
    *((kind, Mode.UNSAFE) for kind in ("emergency", "broken")),
    *(("pass", mode) for mode in Mode if mode not in (Mode.DONE, Mode.UNSAFE, Mode.INTERRUPTED)),
    ("interrupted", Mode.INTERRUPTED),
]
_PLACES = """() => {
    const serial = document.querySelector(".serial"), box = serial.getBoundingClientRect();
    const sizes = [...document.querySelectorAll(".mode, .outcome, .serial")].map(
        (one) => parseFloat(getComputedStyle(one).fontSize) / innerHeight);
    const wide = document.documentElement.scrollWidth > innerWidth;
    const lines = Math.round(box.height / (1.1 * parseFloat(getComputedStyle(serial).fontSize)));
    return {place: [box.top, box.left, box.right].map(Math.round), least: Math.min(...sizes), wide, lines};
}"""


@pytest.fixture(scope="module")
def look(tmp_path_factory):
    with open_store(f"sqlite:///{tmp_path_factory.mktemp('boards') / 'runs.db'}", durable=False) as store:
        return store.live.find_run(store_run(store, "S-0412", ()))


def _boards(look, serial):
    """The board of each state by its name, with those of a scan."""
    site = Pages(Line((), None))
    for kind, mode in _STATES:
        shown = replace(look, **{"outcome": Outcome.PASS, "end": EndReason.FINISHED, **_ENDS[kind]})
        snapshot = Snapshot(
            "line-1", mode, None, replace(shown, serial=serial), (), None, None, serial, "", "", "", True
        )
        yield f"{mode}-{kind}", site.fragment("state", s=snapshot, name="line-1")
        if (kind, mode) == ("pass", Mode.DONE):
            standing = replace(snapshot, standing_failure=look)
            yield "done-standing", site.fragment("state", s=standing, name="line-1")
    for kind in ("may", "again", "refused"):
        yield f"scanned-{kind}", site.fragment("scanned", name="line-1", serial=serial, kind=kind)


@pytest.mark.rest
@pytest.mark.parametrize("size", [(1280, 800), (1024, 768), (768, 1024)])
@pytest.mark.parametrize("serial", ["S-0412", "SENSOR-042", "4006381333931", "SENSOR-2026-11-0412", "S" * 64])
def test_the_serial_number_stands_still_in_every_state(chromium, look, serial, size, tmp_path):
    page = chromium.new_page(viewport={"width": size[0], "height": size[1]})
    html = Pages(Line((), None)).page("problem", control=True, title="", words="")
    sprite = re.search('<svg class="sprite.*</svg>', html, re.DOTALL)[0]
    shots = Path(os.environ.get("CBSR_QA_SHOTS", tmp_path))
    found = {}
    for name, html in _boards(look, serial):
        page.set_content(f'<!doctype html><style>{_CSS}</style>{sprite}<main><div id="state">{html}</div></main>')
        found[name] = page.evaluate(_PLACES)
        page.locator(".board").screenshot(path=shots / f"board-{size[0]}-{size_of(serial)}-{name}.png")
    page.close()
    assert not [name for name, one in found.items() if one["wide"] or (len(serial) < 20 and one["lines"] > 1)]
    assert len({tuple(one["place"]) for one in found.values()}) == 1, found
    assert min(one["least"] for one in found.values()) >= 0.025 * min(1, 800 / size[1]), found
