"""An option of a driver that the reference of instruments does not name is a failing test, and so is one too many."""

import re
from pathlib import Path

import pytest

from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.hooks import Kind

PAGE = (Path(__file__).parents[3] / "docs" / "reference" / "instruments.md").read_text()
PLUGINS = discover()


def options(driver):
    return PLUGINS.factory(Kind.INSTRUMENT, driver).Options.model_fields


def documented(driver):
    """Keys in the first column of a driver's section, or in its row of the last table."""
    section = re.search(rf"^## `{driver}`$(.*?)(?=^## |\Z)", PAGE, re.M | re.S)
    if section is not None:
        cells = re.findall(r"^\| (`[^|]*?) \|", section[1], re.M)
    else:
        cells = re.findall(rf"^\| `{driver}` \|[^|]*\| ([^|]*) \|", PAGE, re.M)
    return {key for cell in cells for key in re.findall(r"`(\w+)`", cell)}


@pytest.mark.parametrize("driver", PLUGINS.names(Kind.INSTRUMENT))
def test_every_option_of_a_driver_is_documented_and_no_other(driver):
    assert documented(driver) == set(options(driver))


@pytest.mark.parametrize("driver", ["keithley-2600", "esp32-multiplexer", "scanned-frames"])
def test_the_defaults_of_the_scanning_drivers_are_the_documented_ones(driver):
    section = re.search(rf"^## `{driver}`$(.*?)(?=^## |\Z)", PAGE, re.M | re.S)[1]
    for keys, values in re.findall(r"^\| (`[^|]*?) \| ([^|]+) \|", section, re.M):
        for key, value in zip(re.findall(r"`(\w+)`", keys), values.strip("` ").split("`, `"), strict=False):
            default = options(driver)[key].default
            if isinstance(default, int | float) and re.fullmatch(r"[\d.]+", value):
                assert default == float(value), key
