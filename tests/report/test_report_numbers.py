"""Numbers as a reader sees them."""

import re

import pytest
from hypothesis import given, strategies as st

from cbsr_qa.domain.plan.limits import Limit
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.report.tables import duration, limit_text, margin_text, number, plain, plural, quantity, with_uncertainty

_POWERS = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹−", "-0123456789-")


def parsed(text):
    """The number a reader would take from the text, without a unit."""
    plain_text = text.translate(_POWERS).replace(" ", "")
    mantissa, _, power = plain_text.partition("×10")
    return float(mantissa) * 10.0 ** int(power or 0)


def parsed_pair(text):
    plain_text = text.translate(_POWERS).replace(" ", "")
    body, _, power = plain_text.partition("×10")
    value, uncertainty = body.strip("()").split("±")
    scale = 10.0 ** int(power or 0)
    return float(value) * scale, float(uncertainty) * scale


@given(st.floats(-1e12, 1e12).filter(lambda v: abs(v) > 1e-12), st.integers(1, 6))
def test_a_number_keeps_its_digits(value, digits):
    assert parsed(number(value, digits)) == pytest.approx(value, rel=0.51 * 10.0 ** (1 - digits))


@given(st.floats(1e-9, 1e9), st.floats(-6, 6))
def test_an_uncertainty_is_kept_to_its_leading_digits(uncertainty, decades):
    value = uncertainty * 10.0**decades
    shown_value, shown = parsed_pair(with_uncertainty(value, uncertainty))
    assert shown == pytest.approx(uncertainty, rel=0.2)
    assert abs(shown_value - value) <= 0.5 * uncertainty


@pytest.mark.parametrize(
    ("value", "uncertainty", "expected"),
    [
        (0.6712, 0.412, "0.7 ± 0.4"),
        (87.93, 2.68, "87.9 ± 2.7"),
        (0.1234, 0.0153, "0.123 ± 0.015"),
        (-5.97, 0.3, "−6.0 ± 0.3"),
        (12345.6, 2000, "12346 ± 2000"),
        (-6.6e-5, 2.3e-5, "(−6.6 ± 2.3) × 10⁻⁵"),
        (3.14159, None, "3.14"),
        (3.14159, 0.0, "3.14"),
        (0.0, 0.02, "0.000 ± 0.020"),
        (1.2345678912, 2.5e-8, "1.234567891 ± 0.000000025"),
    ],
)
def test_value_and_uncertainty(value, uncertainty, expected):
    assert with_uncertainty(value, uncertainty) == expected


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (0, "0"),
        (9.996, "10.0"),
        (99960, "1.00 × 10⁵"),
        (-0.00012345, "−1.23 × 10⁻⁴"),
        (1234.5, "1230"),
        (0.00123, "0.00123"),
    ],
)
def test_significant_digits(value, expected):
    assert number(value) == expected


@pytest.mark.parametrize(
    ("value", "unit", "expected"),
    [
        (18.1e3, "Ω", "18.1 kΩ"),
        (55.3e-6, "S", "55.3 µS"),
        (1e-3, "A", "1.00 mA"),
        (0.8617, "mm", "0.86 mm"),
        (147.3, "mm²", "147 mm²"),
        (1.07, "1", "1.07"),
        (0.00479, "mm", "0.005 mm"),
    ],
)
def test_units_get_a_prefix_only_where_the_trade_uses_one(value, unit, expected):
    assert quantity(value, unit).replace("\N{NO-BREAK SPACE}", " ") == expected


def test_no_more_decimals_than_a_unit_deserves_unless_the_uncertainty_says_so():
    assert plain(0.86173, "mm") == "0.86"
    assert quantity(0.86173, "mm", 0.0021).startswith("0.8617 ± 0.0021")


@pytest.mark.parametrize(
    ("seconds", "expected"),
    [(0.42, "0.42 s"), (59.6, "1 min"), (1100, "18 min 20 s"), (19440, "5 h 24 min"), (3600, "1 h"), (3599.7, "1 h")],
)
def test_durations(seconds, expected):
    assert duration(seconds) == expected


def test_no_text_ever_holds_a_programmers_exponent():
    for exponent in range(-12, 13):
        assert not re.search(r"\de[+-]?\d", with_uncertainty(1.234 * 10.0**exponent, 10.0 ** (exponent - 2)))
        assert not re.search(r"\de[+-]?\d", number(1.234 * 10.0**exponent))


def test_limits_are_written_as_they_were_set():
    assert limit_text(Limit("m", "mm", None, 6.5)) == "≤ 6.5\N{NO-BREAK SPACE}mm"
    assert limit_text(Limit("m", "1", 0.5, 1.5)) == "0.5 to 1.5"
    assert limit_text(Limit("m", "Ω", 1e3, 4e4)) == "1 to 40\N{NO-BREAK SPACE}kΩ"
    assert limit_text(Limit("m", "%/min", -0.5, 0.5)).startswith("−0.5 to 0.5")


def test_a_margin_has_the_sign_of_being_inside():
    limit = Limit("m", "mm", None, 5.0)
    assert margin_text(Measurement("m", 4.0, "mm").judge(limit)).startswith("+1.00")
    assert margin_text(Measurement("m", 6.0, "mm").judge(limit)).startswith("−1.00")
    assert margin_text(Measurement("m", None, "mm", how="lost").judge(limit)) == ""


def test_counts_with_their_noun():
    assert [plural(n, "load") for n in (0, 1, 9)] == ["no loads", "1 load", "9 loads"]
    assert plural(2, "press", "presses") == "2 presses"
