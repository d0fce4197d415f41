"""One served line and one browser for all tests of pages."""

import os
from pathlib import Path

import pytest
from served_line import TOKEN, ServedLine

CHROMIUM = Path("/usr/bin/chromium")
_ARGUMENTS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]


@pytest.fixture(scope="session")
def served_line(tmp_path_factory):
    """A line that is served for all tests."""
    line = ServedLine(tmp_path_factory.mktemp("line"))
    try:
        yield line.start()
    finally:
        line.stop()


@pytest.fixture
def line(served_line, monkeypatch):
    """The served line; its lock files are found by the test too, and by no other test of this process."""
    monkeypatch.setenv("CBSR_QA_VAR", str(served_line.folder / "var"))
    return served_line


@pytest.fixture(scope="session")
def chromium():
    """A real browser; skips, saying so, without one."""
    if not CHROMIUM.exists():
        pytest.skip(f"there is no browser at {CHROMIUM}")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=_ARGUMENTS)
        yield browser
        browser.close()


@pytest.fixture
def pages(line, chromium, tmp_path):
    """Makes pages that are signed in; none may raise an error, or ask another computer for anything."""
    context = chromium.new_context(viewport={"width": 1280, "height": 800}, base_url=line.address)
    context.set_default_timeout(60_000)
    complaints = []
    shots = Path(os.environ.get("CBSR_QA_SHOTS", tmp_path))

    def new(path="/"):
        page = context.new_page()
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("request", lambda one: one.url.startswith((line.address, "data:")) or complaints.append(one.url))
        page.goto(f"{path}?token={TOKEN}")
        page.shot = lambda name: page.screenshot(path=shots / f"{name}.png")
        return page

    yield new
    context.close()
    assert not complaints
