"""A driver that the page on instruments does not name is a failing test, and so is one too many."""

import re
from pathlib import Path

import pytest

from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.hooks import Kind

REFERENCE = Path(__file__).parents[3] / "docs" / "reference"
PAGE = (REFERENCE / "instruments.md").read_text(encoding="utf-8")
OPTIONS = (REFERENCE / "plugins.md").read_text(encoding="utf-8")
PLUGINS = discover()


def test_the_page_leads_to_every_driver_and_no_other():
    assert set(re.findall(r"\[`([\w-]+)`\]\(plugins\.md#\1\)", PAGE)) == set(PLUGINS.names(Kind.INSTRUMENT))


@pytest.mark.parametrize("driver", PLUGINS.names(Kind.INSTRUMENT))
def test_every_option_of_a_driver_stands_where_the_page_leads(driver):
    section = re.search(rf"^### `{driver}`$(.*?)(?=^##|\Z)", OPTIONS, re.M | re.S)[1]
    assert set(re.findall(r"^\| `(\w+)` \|", section, re.M)) == set(
        PLUGINS.factory(Kind.INSTRUMENT, driver).Options.model_fields
    )
