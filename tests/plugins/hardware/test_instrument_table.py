"""Options of an instrument's table: refusals name role, driver, key and what is allowed."""

import pytest
from simulated_setting import context

from cbsr_qa.domain import ConfigError
from cbsr_qa_plugins.hardware._options import InstrumentTable

KNOWN = ("scene", "address", "baud", "centre_mm", "firmware", "loud")


def table(**options):
    return InstrumentTable(context(None, options=options), "press", KNOWN)


def test_an_unknown_key_is_answered_by_the_nearest():
    with pytest.raises(ConfigError, match=r"instrument 'bench' \(press\) has no option 'adress'") as caught:
        table(adress="x")
    assert "did you mean 'address'?" in caught.value.remedy


def test_values_are_read():
    one = table(address="/dev/x", baud=9600, centre_mm=[1, 2.5], firmware="prusa", loud=True)
    assert one.text("address") == "/dev/x"
    assert one.whole("baud", 115200, at_least=300, at_most=4_000_000) == 9600
    assert one.number("baud", at_least=300) == 9600.0
    assert one.numbers("centre_mm", 2) == (1.0, 2.5)
    assert one.choice("firmware", ("prusa", "marlin")) == "prusa"
    assert one.flag("loud", False)
    assert one.has("baud")


def test_defaults_are_used():
    one = table()
    assert one.whole("baud", 115200, at_least=300, at_most=4_000_000) == 115200
    assert one.choice("firmware", ("prusa", "marlin"), "marlin") == "marlin"
    assert one.flag("loud", False) is False
    assert not one.has("baud")


@pytest.mark.parametrize(
    "read",
    [
        lambda one: one.text("address"),
        lambda one: one.number("baud"),
        lambda one: one.numbers("centre_mm", 2),
        lambda one: one.choice("firmware", ("prusa",)),
    ],
)
def test_what_is_needed_and_missing_is_named(read):
    with pytest.raises(ConfigError, match="needs option") as caught:
        read(table())
    assert caught.value.remedy


@pytest.mark.parametrize(
    ("options", "read", "allowed"),
    [
        ({"address": 3}, lambda one: one.text("address"), "a text"),
        ({"address": " "}, lambda one: one.text("address"), "a text"),
        (
            {"baud": 9600.0},
            lambda one: one.whole("baud", at_least=1, at_most=9),
            "a whole number of at least 1 and at",
        ),
        ({"baud": True}, lambda one: one.whole("baud", at_least=1, at_most=9), "a whole number"),
        ({"baud": float("nan")}, lambda one: one.number("baud"), "a finite number"),
        ({"baud": 0}, lambda one: one.number("baud", at_least=1), "of at least 1"),
        ({"baud": 3}, lambda one: one.number("baud", at_most=1), "of at most 1"),
        ({"centre_mm": [1]}, lambda one: one.numbers("centre_mm", 2), "a list of 2 finite numbers"),
        ({"centre_mm": [1, "2"]}, lambda one: one.numbers("centre_mm", 2), "a list of 2 finite numbers"),
        ({"firmware": "prosa"}, lambda one: one.choice("firmware", ("prusa", "marlin")), "did you mean 'prusa'?"),
        ({"loud": 1}, lambda one: one.flag("loud", False), "true or false"),
    ],
)
def test_wrong_values_are_refused(options, read, allowed):
    with pytest.raises(ConfigError, match=rf"instrument 'bench' \(press\): {next(iter(options))} is") as caught:
        read(table(**options))
    assert allowed in caught.value.remedy
