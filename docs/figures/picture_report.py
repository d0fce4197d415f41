"""Write docs/pictures/report.webp: the head and the first figure of a report, as a browser shows them.

``python docs/figures/picture_report.py var/reports/DEMO-001-….html`` after ``make demo``; it needs Chromium.
"""

import io
import sys
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

PICTURE = Path(__file__).parents[1] / "pictures" / "report.webp"
PARTS = (".banner", ".simulated", "figure.drawing")
MARGIN_PX = 24

if __name__ == "__main__":
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 800, "height": 1600}, device_scale_factor=1.5)
        page.goto(Path(sys.argv[1]).resolve().as_uri())
        parts = [Image.open(io.BytesIO(page.locator(part).first.screenshot())) for part in PARTS]
    width = max(part.width for part in parts) + 2 * MARGIN_PX
    picture = Image.new("RGB", (width, sum(part.height + MARGIN_PX for part in parts) + MARGIN_PX), "white")
    top = MARGIN_PX
    for part in parts:
        picture.paste(part, (MARGIN_PX, top))
        top += part.height + MARGIN_PX
    PICTURE.parent.mkdir(exist_ok=True)
    picture.save(PICTURE, quality=80, method=6)
