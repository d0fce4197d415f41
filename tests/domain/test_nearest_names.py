"""The nearest of known names, as a person would choose it."""

import pytest

from cbsr_qa.domain.numbers import did_you_mean

SERIALS = [f"S-{number:02d}" for number in range(1, 31)]


@pytest.mark.parametrize(
    ("name", "known", "nearest"),
    [
        ("S-5", SERIALS, "S-05"),
        ("s05", SERIALS, "S-05"),
        ("S-31", SERIALS, "S-30"),
        ("S-005", SERIALS, "S-05"),
        ("batch-2/12", ["batch-2/11", "batch-1/12", "batch-22/1"], "batch-2/11"),
        ("drit", ["noise_floor", "drift"], "drift"),
        ("Drift", ["drifts", "drift"], "drift"),
        ("lot9", ["LOT12", "BOARD-9"], "LOT12"),
        ("lognormal", ["normal", "log-normal"], "log-normal"),
        ("S-" + 5000 * "1", ["S-1", "S-" + 4999 * "1"], "S-" + 4999 * "1"),
    ],
)
def test_numbers_in_names_count_as_numbers(name, known, nearest):
    assert did_you_mean(name, known) == f"did you mean {nearest!r}?"


def test_what_is_near_nothing_has_no_suggestion():
    assert did_you_mean("S-5", []) == ""
    assert did_you_mean("S-5", ["golden", "B-1000"]) == ""
