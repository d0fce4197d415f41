"""Margins and differences to be found: what is adjusted, which interval decides, and how many sensors it takes."""

import re
from pathlib import Path

import numpy as np
import pytest
from compared_fleets import ERROR, compared, json_of
from stored_lots import judged, measured, store_run

from cbsr_qa.report.render import render_sections
from cbsr_qa.report.tables import number
from cbsr_qa.report.terminal import terminal_lines
from cbsr_qa.stats.power_analysis import power, power_of_equivalence
from cbsr_qa.store.opening import open_store
from cbsr_qa.studies.compare.terms import Adjustment, By

pytestmark = pytest.mark.rest


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


def printed(made):
    return list(terminal_lines(made.page, made.sections))


def differences(made, name):
    return {one["group"]: one for one in json_of(made)["metrics"] if one["name"] == name}


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


def test_a_table_shows_the_interval_that_decides_and_what_it_comes_to(url):
    margin = decided_by_holm(url)
    made = compared(url, margins={ERROR: margin})
    rows = [line for line in printed(made) if "± " in line]
    assert [row.count("not shown") for row in rows] == [1, 1]
    wide = compared(url, margins={ERROR: 50 * margin})
    low, high = differences(made, ERROR)["42"]["equivalence_interval"]
    assert any(f"{number(low)} to {number(high)}" in row for row in rows)
    assert all("yes" in line for line in printed(wide) if "± " in line)


def test_a_margin_is_offered_only_where_none_was_given(url):
    plain, asked = (" ".join(compared(url, margins=m).result.sentences) for m in ({}, {ERROR: 0.3}))
    assert ("--margin" in plain, "--margin" in asked) == (True, False)


def test_sensors_to_find_are_of_the_stated_difference_and_those_to_show_of_the_margin(url):
    made = compared(url, margins={ERROR: 0.3}, detect={ERROR: 0.2})
    one = differences(made, ERROR)["42"]
    for count, size, succeeds in (
        (one["sensors_needed"], 0.2, power),
        (one["sensors_to_show_alike"], 0.3, power_of_equivalence),
    ):
        by, fewer = (succeeds(size / one["deviation"], n, n) for n in (count, count - 1))
        assert fewer < 0.8 <= by
    lines = printed(made)
    heading = next(number for number, line in enumerate(lines) if "that would find a difference with 80 %" in line)
    assert lines[heading + 2].split()[-1] == str(one["sensors_needed"])
    assert any("one test at the level 0.05 succeeds with 80 %" in rule for rule in made.result.rules)


def test_a_margin_below_the_estimate_is_shown_by_no_number_of_sensors(url):
    value = abs(differences(compared(url), ERROR)["42"]["difference"])
    for margin, hopeless in ((0.9 * value, True), (1.1 * value, False)):
        made = compared(url, margins={ERROR: margin}, groups=("41", "42"))
        (row,) = (line for line in printed(made) if "± " in line)
        count = differences(made, ERROR)["42"]["sensors_to_show_alike"]
        assert row.endswith("not possible" if hopeless else str(count))


def test_what_is_asked_of_a_metric_that_is_not_compared_is_not_tested_and_not_known(url):
    made = compared(url, detect={"missed_loads": 1.0}, margins={"missed_loads": 1.0})
    rows = [line.split() for line in printed(made) if "missed loads" in line and "compared" not in line]
    assert any(row[-2:] == ["not", "known"] for row in rows)
    assert sum(row[-3:-1] == ["not", "tested"] for row in rows) == 2


def test_one_station_is_not_said_to_be_taken_out(url):
    assert any("42 − 41, all of station A; " in line for line in printed(compared(url)))


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
    document = json_of(compared(url, by, margins={ERROR: 0.3}, detect={ERROR: 0.2}))
    made = keys(document) - _SHARES
    assert made - set(re.findall(r"`(\w+)", section)) == set()
    if by is By.BATCH:
        entries = section.split("An entry of `metrics[]`")[1]
        first = {word for row in re.findall(r"^\| (`.*?) \|", entries, re.M) for word in re.findall(r"`(\w+)", row)}
        assert first == set(document["metrics"][0])


def test_the_document_has_an_entry_of_each_metric_and_group_with_the_same_keys(url):
    document = json_of(compared(url))
    pairs = [(one["name"], one["group"]) for one in document["metrics"]]
    assert pairs == [
        (name, group) for name in (ERROR, "drift", "noise_floor", "missed_loads") for group in ("42", "43")
    ]
    (one, *_) = json_of(compared(url, groups=("41",)))["metrics"]
    assert (one["group"], one["model"]) == (None, "none")
    assert set(one) == set(document["metrics"][0])


def test_the_page_has_tables_of_likeness_and_of_sensors(url):
    made = compared(url, margins={ERROR: 0.3}, detect={ERROR: 0.2})
    html = render_sections(made.page, made.sections)
    assert "42 − 41: alike within a margin?" in html
    assert ">90 % interval</th>" in html
    count = differences(made, ERROR)["42"]["sensors_needed"]
    assert f'<td class="number tight"><bdi>{count}</bdi></td>' in html
    assert "a row is a group at a station, a point a sensor" in html
    # Numbers, also of the other methods, stand in columns that are not broken.
    shift = differences(made, ERROR)["42"]["robust"]["shift"]
    assert f'<td class="number tight"><bdi>{number(shift)}</bdi></td>' in html
