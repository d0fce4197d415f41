"""Write docs/reference/plugins.md from the built-in plugins' own code."""

from pathlib import Path

from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.reference import reference_page

PAGE = Path(__file__).parents[1] / "reference" / "plugins.md"

if __name__ == "__main__":
    PAGE.write_text(reference_page(discover(), "cbsr-qa"), encoding="utf-8")
