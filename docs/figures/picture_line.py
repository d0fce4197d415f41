"""Write docs/how-to/pictures/line-*.webp: two stations of ``make serve``, as a browser shows them.

``python docs/figures/picture_line.py`` takes two minutes; it needs Chromium.
"""

import io
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, expect, sync_playwright

PICTURES = Path(__file__).parents[1] / "how-to" / "pictures"
RUN_MS = 300_000
#: The sheet answers by then, and the head still presses: a hold of 60 s takes one at this clock.
HOLDING = re.compile(r"^\s*Press \d+ of \d+ · holding still")
HOLD_MS = 300
SERVE = "from cbsr_qa.cli.main import entry; entry()"


def start(page: Page, serial: str) -> None:
    """Type a serial number as a scanner does, and start with the keyboard alone."""
    page.locator("#serial").fill(serial)
    page.keyboard.press("Enter")
    expect(page.locator("#gate button")).to_be_focused()
    page.keyboard.press("Enter")


def write(page: Page, name: str) -> None:
    """Write what the browser shows as docs/how-to/pictures/<name>.webp."""
    picture = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
    picture.save(PICTURES / f"{name}.webp", quality=80, method=6)


def pictures(address: str) -> None:
    """Test one sensor at the second station, then another at the first."""
    base, token = address.split("/?")
    expect.set_options(timeout=RUN_MS)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.goto(f"{base}/stations/line-2?{token}")
        start(page, "S-0412")
        expect(page.locator(".verdict")).to_contain_text("S-0412")
        write(page, "line-verdict")
        page.goto(f"{base}/stations/line-1")
        start(page, "S-0413")
        expect(page.locator(".places small", has_text="mm off")).to_have_count(3)
        expect(page.get_by_text(HOLDING)).to_be_visible()
        expect(page.locator("circle.head")).to_be_visible()
        page.wait_for_timeout(HOLD_MS)
        write(page, "line-running")
        page.goto(base)
        expect(page.locator("article, .card").first).to_be_visible()
        write(page, "line-overview")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        stations = ["--station", "line-1", "--station", "line-2"]
        serve = subprocess.Popen(
            [sys.executable, "-u", "-c", SERVE, "serve", *stations, "--recipe", "nine-locations", "--port", "0"],
            env={**os.environ, "CBSR_QA_VAR": folder},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        try:
            assert serve.stdout is not None
            pictures(next(found[0] for line in serve.stdout if (found := re.search(r"http://\S+token=\S+", line))))
        finally:
            serve.terminate()
            serve.wait()
