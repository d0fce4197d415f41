"""An option of a driver that the reference of instruments does not name is a failing test, and so is one too many."""

import importlib
import re
from pathlib import Path

import pytest

from cbsr_qa.config import load_material, load_scene, load_sensor_type
from cbsr_qa.domain import ConfigError
from cbsr_qa.domain.plan import Motion
from cbsr_qa.domain.run import Indenter
from cbsr_qa.plugin import Kind, StationContext
from cbsr_qa.system import VirtualClock
from cbsr_qa_plugins.registry import BUILT_IN

PAGE = (Path(__file__).parents[3] / "docs" / "reference" / "instruments.md").read_text()
DRIVERS = {name: where for kind, name, where in BUILT_IN if kind is Kind.INSTRUMENT}


def options(driver):
    """Keys of a driver, as it names them when it refuses another."""
    module, _, factory = DRIVERS[driver].partition(":")
    opened = getattr(importlib.import_module(f"cbsr_qa_plugins.{module}"), factory)
    sensor, material = load_sensor_type("disc-100mm").value, load_material("cbsr-8wt").value
    context = StationContext(
        "role", VirtualClock(), sensor, material, Indenter(13.0), 1, {"no such key": 1}, load_scene("none").value,
        lambda name: None, Motion(1.0, 1.0, 1.0), ask=lambda text: "",
    )  # fmt: skip
    with pytest.raises(ConfigError, match="has no option 'no such key'") as refused:
        opened(context)
    return set(re.findall(r"\w+", refused.value.remedy.rpartition("it has ")[2]))


def documented(driver):
    """Keys in the first column of a driver's section, or in its row of the last table."""
    section = re.search(rf"^## `{driver}`$(.*?)(?=^## |\Z)", PAGE, re.M | re.S)
    if section is not None:
        cells = re.findall(r"^\| (`[^|]*?) \|", section[1], re.M)
    else:
        cells = re.findall(rf"^\| `{driver}` \|[^|]*\| ([^|]*) \|", PAGE, re.M)
    return {key for cell in cells for key in re.findall(r"`(\w+)`", cell)}


@pytest.mark.parametrize("driver", DRIVERS)
def test_every_option_of_a_driver_is_documented_and_no_other(driver):
    assert documented(driver) == options(driver)


def test_the_defaults_of_the_scanning_drivers_are_the_documented_ones():
    for driver in ("keithley_2600", "esp32_multiplexer", "scanned_frames"):
        source = (Path(__file__).parents[3] / "plugins/cbsr_qa_plugins/hardware" / f"{driver}.py").read_text()
        section = re.search(rf"^## `{driver.replace('_', '-')}`$(.*?)(?=^## |\Z)", PAGE, re.M | re.S)[1]
        for keys, values in re.findall(r"^\| (`[^|]*?) \| ([^|]+) \|", section, re.M):
            for key, value in zip(re.findall(r"`(\w+)`", keys), values.strip("` ").split("`, `"), strict=False):
                stated = re.search(rf'"{key}", ([\d.]+),', source)
                if stated and re.fullmatch(r"[\d.]+", value):
                    assert float(stated[1]) == float(value), (driver, key)
