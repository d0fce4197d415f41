"""Margins and differences to be found: what is adjusted, which interval decides, and how many sensors it takes."""

import re
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from stored_lots import judged, measured, store_run

from cbsr_qa.cli.studies import compare as command
from cbsr_qa.report import number
from cbsr_qa.stats import power, power_of_equivalence
from cbsr_qa.store import open_store
from cbsr_qa.studies.compare.from_store import RunChoice, compare_groups
from cbsr_qa.studies.compare.page import write_page
from cbsr_qa.studies.compare.terms import Adjustment, By, Terms
from cbsr_qa.studies.compare.wording import rules, sentences

pytestmark = pytest.mark.rest

NOW = datetime(2026, 12, 24, tzinfo=UTC)
ERROR = "centre_of_mass_error"


@pytest.fixture(scope="module")
def url(tmp_path_factory):
    """Batches 41, 42 and 43, all at one station, that do not differ."""
    found = f"sqlite:///{tmp_path_factory.mktemp('margins') / 'fleet.db'}"
    random = np.random.default_rng(15)
    with open_store(found, durable=False) as store:
        for number in range(30):
            values = judged(measured(random, random.standard_normal(3)))
            store_run(store, f"S-{number:02d}", values, batch=("41", "42", "43")[number % 3], station="A")
    return found


def compared(url, by=By.BATCH, **terms):
    return compare_groups(RunChoice(), Terms(by, **terms), database=url, now=NOW)


def differences(made, name):
    return {one["group"]: one for one in made.document()["metrics"] if one["name"] == name}


def decided_by_holm(url):
    """A margin just wide enough for the first of two tests by itself, not for both together."""
    plain = differences(compared(url, margins={ERROR: 1.0}), ERROR).values()
    return 1.0001 * max(abs(end) for end in min((one["equivalence_interval"] for one in plain), key=reach))


def reach(ends):
    return max(abs(end) for end in ends)


def test_likeness_is_adjusted_for_the_number_of_such_tests(url):
    margin = decided_by_holm(url)
    alone = differences(compared(url, margins={ERROR: margin}, adjustment=Adjustment.NONE), ERROR).values()
    holm = differences(compared(url, margins={ERROR: margin}), ERROR).values()
    (best,) = (one for one in alone if one["equivalent"])
    assert best["equivalence_p"] == best["equivalence_p_unadjusted"] == pytest.approx(0.05, abs=1e-3)
    assert reach(best["equivalence_interval"]) < margin
    assert not any(one["equivalent"] for one in holm)
    assert min(one["equivalence_p"] for one in holm) == pytest.approx(2 * best["equivalence_p"])


def test_sentences_show_the_interval_that_decides_and_why_it_does_not(url):
    margin = decided_by_holm(url)
    made = compared(url, margins={ERROR: margin})
    said = [words for words in sentences(made.found) if "not shown to be alike" in words]
    assert len(said) == 2
    assert (
        sum("interval, " in words and "lies within, but not once both such tests count" in words for words in said)
        == 1
    )
    wide = " ".join(sentences(compared(url, margins={ERROR: 50 * margin}).found))
    low, high = differences(made, ERROR)["42"]["equivalence_interval"]
    assert "42 and 41 are alike within ± " in wide
    assert f"the 90 % interval, {number(low)} to {number(high)} mm, lies within (p " in wide


def test_no_margin_is_asked_for_where_one_was_given(url):
    every = compared(url, margins={ERROR: 0.01, "drift": 0.01, "noise_floor": 1e-4})
    said = " ".join(sentences(every.found))
    assert "Not shown to differ: " in said
    assert "state a margin" not in said
    some = [s for s in sentences(compared(url, margins={"drift": 0.01}).found) if s.startswith("Not shown to differ")]
    assert [("drift" in words, "state a margin" in words) for words in some] == [(False, True), (True, False)]


def test_sensors_to_find_are_of_the_stated_difference_and_those_to_show_of_the_margin(url):
    made = compared(url, margins={ERROR: 0.3}, detect={ERROR: 0.2})
    one = differences(made, ERROR)["42"]
    for count, size, succeeds in (
        (one["sensors_needed"], 0.2, power),
        (one["sensors_to_show_alike"], 0.3, power_of_equivalence),
    ):
        by, fewer = (succeeds(size / one["deviation"], n, n) for n in (count, count - 1))
        assert fewer < 0.8 <= by
    said = " ".join(sentences(made.found))
    found = f"about {one['sensors_needed']} sensors of each, all at one station, would find a difference of 0.200 mm"
    assert f"{found} with 80 %" in said
    printed = " ".join(" ".join(command.lines(made.found)).split())
    assert f"{found} with 80 %" in printed
    assert "one test at the level 0.05 succeeds with 80 %" in printed


def test_a_margin_below_the_estimate_is_shown_by_no_number_of_sensors(url):
    value = abs(differences(compared(url), ERROR)["42"]["difference"])
    for margin, hopeless in ((0.9 * value, True), (1.1 * value, False)):
        made = compared(url, margins={ERROR: margin}, groups=("41", "42"))
        (said,) = (words for words in sentences(made.found) if "not shown to be alike" in words)
        count = differences(made, ERROR)["42"]["sensors_to_show_alike"]
        assert ("no number of sensors would show it" in said) == hopeless
        assert (f"If they do not differ, about {count} sensors of each" in said) != hopeless


def test_a_difference_to_be_found_in_what_is_not_compared_is_said(url):
    said = sentences(compared(url, detect={"missed_loads": 1.0}).found)
    assert "missed_loads: not compared, so how many sensors would find 1.00 is not known." in said


def test_rules_say_what_is_adjusted(url):
    plain, asked = (" ".join(rules(compared(url, margins=m).found)) for m in ({}, {ERROR: 0.3}))
    assert "Those of t tests and of robust tests are not adjusted" in plain
    assert "two one-sided tests" not in plain
    assert "its 90 % interval lies within; their p values are, among themselves, adjusted by Holm's method" in asked


def test_one_station_is_not_said_to_be_taken_out(url, tmp_path):
    random = np.random.default_rng(16)
    other = f"sqlite:///{tmp_path / 'other.db'}"
    with open_store(other, durable=False) as store:
        for number in range(16):
            batch = ("41", "42")[number % 2]
            shifted = random.standard_normal(3) + 20 * (batch == "42")
            store_run(store, f"S-{number:02d}", judged(measured(random, shifted)), batch=batch, station="A")
    first = sentences(compared(other).found)[0]
    assert first.endswith(", all at A.")


#: Keys that are data: shares of quantiles.
_SHARES = {"0.05", "0.25", "0.5", "0.75", "0.95"}


def keys(document):
    if isinstance(document, dict):
        return set(document).union(*(keys(value) for value in document.values()))
    return set().union(*map(keys, document)) if isinstance(document, list) else set()


@pytest.mark.parametrize("by", [By.BATCH, By.STATION])
def test_every_key_of_the_document_is_documented_and_every_one_documented_is_there(url, by):
    page = (Path(__file__).parents[3] / "docs" / "reference" / "station-statistics.md").read_text()
    (section,) = re.findall(r"^## `cbsr-qa compare --json`\n(.*?)^## ", page, re.M | re.S)
    document = compared(url, by, margins={ERROR: 0.3}, detect={ERROR: 0.2}).document()
    made = keys(document) - _SHARES
    assert made - set(re.findall(r"`(\w+)", section)) == set()
    if by is By.BATCH:
        entries = section.split("An entry of `metrics[]`")[1]
        first = {word for row in re.findall(r"^\| (`.*?) \|", entries, re.M) for word in re.findall(r"`(\w+)", row)}
        assert first == set(document["metrics"][0])


def test_the_document_has_an_entry_of_each_metric_and_group_with_the_same_keys(url):
    document = compared(url).document()
    pairs = [(one["name"], one["group"]) for one in document["metrics"]]
    assert pairs == [
        (name, group) for name in (ERROR, "drift", "noise_floor", "missed_loads") for group in ("42", "43")
    ]
    (one, *_) = compared(url, groups=("41",)).document()["metrics"]
    assert (one["group"], one["model"]) == (None, "none")
    assert set(one) == set(document["metrics"][0])


def test_the_page_has_tables_of_likeness_and_of_sensors(url, tmp_path):
    made = compared(url, margins={ERROR: 0.3}, detect={ERROR: 0.2})
    write_page(made.found, tmp_path / "page.html")
    html = (tmp_path / "page.html").read_text()
    assert "42 − 41: alike within a margin?" in html
    assert ">90 % interval</th>" in html
    assert "Sensors of each group that would find a difference with 80 %" in html
    count = differences(made, ERROR)["42"]["sensors_needed"]
    assert f'<td class="number tight"><bdi>{count}</bdi></td>' in html
    assert "a row is a group at a station, a point a sensor" in html
    # Numbers, also of the other methods, stand in columns that are not broken.
    shift = differences(made, ERROR)["42"]["robust"]["shift"]
    assert f'<td class="number tight"><bdi>{number(shift)}</bdi></td>' in html
