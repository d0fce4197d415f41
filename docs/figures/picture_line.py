"""Write docs/how-to/pictures/line-*.webp: two stations as those of ``make serve``, as a browser shows them.

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
#: One of the later places, and time for the sheet to answer.
LATER_PLACE = re.compile(r"Press ([7-9]|1[01]) of 23")
ANSWER_MS = 800
#: Shipped recipe, and its limit of the overlap as in the recipe of the picture of a failed sensor.
RECIPE = Path(__file__).parents[2] / "stations" / "recipes" / "nine-locations.toml"
STRICT = (('name = "nine-locations"', 'name = "strict"'), ("lower = 50.0 ", "lower = 75.0 "))
SERVE = "from cbsr_qa.cli.main import entry; entry()"


def start(page: Page, serial: str, recipe: str) -> None:
    """Type a serial number as a scanner does, and start with the keyboard alone."""
    page.locator("#recipe").select_option(recipe)
    page.locator("#serial").fill(serial)
    page.keyboard.press("Enter")
    expect(page.locator("#gate [action$='/start'] button")).to_be_focused()
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
        start(page, "S-0412", "strict")
        expect(page.locator("#state .outcome")).to_have_text("Failed")
        write(page, "line-verdict")
        page.goto(f"{base}/stations/line-1")
        start(page, "S-0413", "nine-locations")
        expect(page.locator(".progress")).to_have_text(LATER_PLACE)
        page.wait_for_timeout(ANSWER_MS)
        write(page, "line-running")
        page.goto(base)
        expect(page.locator(".card").first).to_be_visible()
        write(page, "line-overview")
        page.goto(f"{base}/stations/line-1")
        expect(page.locator("#state .outcome")).to_have_text("Passed")
        page.locator("#serial").fill("S-0413")
        page.keyboard.press("Enter")
        expect(page.locator("#gate-title")).to_contain_text("Test again?")
        write(page, "line-again")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        recipe = RECIPE.read_text(encoding="utf-8")
        for shipped, strict in STRICT:
            recipe = recipe.replace(shipped, strict)
        (Path(folder) / "strict.toml").write_text(recipe, encoding="utf-8")
        served = ["--station=line-1", "--station=line-2", "--recipe=nine-locations", f"--recipe={folder}/strict.toml"]
        serve = subprocess.Popen(
            [sys.executable, "-u", "-c", SERVE, "serve", *served, "--port=0"],
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
