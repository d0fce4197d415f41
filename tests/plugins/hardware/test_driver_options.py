"""What the options of every driver refuse, by key and value, before anything is opened."""

from dataclasses import replace

import pytest
from simulated_setting import context

from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.hooks import Kind

PLUGINS = discover()
DRIVERS = [r.name for r in PLUGINS.registrations(Kind.INSTRUMENT)]

#: What a table must say, and options that are wrong beside it.
GIVEN = {
    "ert-board-stream": {"address": "x", "frame_period_s": 0.25},
    "esp32-multiplexer": {"address": "x", "inner": "current"},
    "keithley-2600": {"address": "x"},
    "manual-load-cell": {"unit": "N", "capacity": 50},
    "marlin-applicator": {"address": "x", "centre_mm": [1, 2], "hover_height_mm": 60.0},
    "phidget-bridge": {"scale": 5e6},
    "replayed-recording": {"file": "x"},
    "serial-load-cell": {"address": "x"},
    "serial-thermometer": {"address": "x"},
}
WRONG = {
    "ert-board-stream": [
        {"format": "text"},
        {"frame_period_s": 0.004},
        {"range_counts": [5, 5]},
        {"range_counts": [0, 70_000]},
        {"order": "voltage"},
        {"first_reading": 256},
        {"memory_share": 0.9},
        {"current_mA": 0},
    ],
    "esp32-multiplexer": [{"inner": "drive"}, {"settle_ms": -1}],
    "keithley-2600": [{"nplc": 30}, {"source_channel": "c"}, {"readings": 0}],
    "manual-applicator": [{"tolerance_mm": 0}],
    "manual-load-cell": [{"unit": "lb"}],
    "manual-thermometer": [{"every_min": 0}],
    "marlin-applicator": [{"centre_mm": [1]}, {"firmware": "reprap"}],
    "phidget-bridge": [{"gain": 7}, {"gain": True}, {"gain": 8.0}, {"data_interval_ms": 4}, {"channel": -1}],
    "scanned-frames": [{"current": "most"}, {"current_mA": -1}, {"contacts": "ignore"}],
    "serial-load-cell": [{"unit": "lb"}, {"scale": 0}, {"sign": 0}, {"time": "gps"}, {"rate_hz": 0}, {"limit_N": -1}],
    "simulated-bench": [{"hover_mm": 0}],
}
#: Options that do not fit together, and what is said of which.
UNFIT = [
    ("ert-board-stream", {"signed": True}, "signed is true"),
    ("ert-board-stream", {"format": "ascii"}, "baud is missing"),
    ("keithley-2600", {"source_channel": "a"}, "meter_channel is 'a'"),
    ("marlin-applicator", {"firmware": "marlin"}, "steps_per_mm is missing"),
    ("marlin-applicator", {"firmware": "marlin", "steps_per_mm": [0, 1, 1]}, "steps_per_mm[1] is 0"),
    ("scanned-frames", {"current": "auto", "current_mA": 0.4}, "current is given, and current_mA too"),
    ("serial-load-cell", {"unit": "counts"}, "scale is missing"),
]


def refused(driver, options):
    told = replace(context(None), role="one", options=options)
    with pytest.raises(ConfigError) as error:
        PLUGINS.factory(Kind.INSTRUMENT, driver)(told)
    who = f"instrument 'one' ({driver}): "
    assert error.value.reason.startswith(who)
    return error.value.reason.removeprefix(who)


@pytest.mark.parametrize(
    ("driver", "key", "value"),
    [(driver, *pair) for driver, wrongs in WRONG.items() for wrong in wrongs for pair in wrong.items()],
)
def test_a_value_that_is_not_allowed_is_refused_by_key_and_value(driver, key, value):
    assert refused(driver, GIVEN.get(driver, {}) | {key: value}).startswith(f"{key} is {value!r}")


@pytest.mark.parametrize(("driver", "options", "said"), UNFIT)
def test_options_that_do_not_fit_together_are_refused(driver, options, said):
    assert refused(driver, GIVEN.get(driver, {}) | options).startswith(said)


@pytest.mark.parametrize(("driver", "key"), [(driver, key) for driver, given in GIVEN.items() for key in given])
def test_what_a_table_must_say_is_asked_for(driver, key):
    assert (
        refused(driver, {name: value for name, value in GIVEN[driver].items() if name != key}) == f"{key} is missing"
    )


@pytest.mark.parametrize("driver", DRIVERS)
def test_an_option_that_no_driver_has_is_refused(driver):
    assert refused(driver, GIVEN.get(driver, {}) | {"nowhere": 1}) == "nowhere is not a known key"
