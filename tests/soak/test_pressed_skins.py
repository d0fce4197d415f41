"""Places on two real skins, learned from presses: every figure of docs/explanation/place.md."""

import re

import numpy as np
import pytest
from pages import HOW_TO

from benchmarks.pressed_places import GOALS, split
from cbsr_qa.calibration.place.estimator import PlaceEstimator
from cbsr_qa.calibration.place.learning import learn_place
from cbsr_qa.calibration.place.mixture import mahalanobis
from cbsr_qa.studies.frontier.presses.trial import try_presses

PAGE = (HOW_TO.parent / "explanation" / "place.md").read_text(encoding="utf-8")
RE_CHECKS = 20
CASES = [(name, count) for name, counts in GOALS.items() for count in counts]


@pytest.mark.parametrize(("name", "count"), CASES)
def test_error_and_regions_from_so_many_presses(skins, name, count):
    """Mean over all splits: the requirement is met, and the page states what is found."""
    splits, limit_mm = GOALS[name][count]
    trials = [split(skins(name), count, seed) for seed in range(splits)]
    errors = np.array([one.error_mm.mean() for one in trials])
    assert errors.mean() <= limit_mm
    low, high = np.mean([one.inside.mean(axis=0) for one in trials], axis=0)
    if count >= 39:
        assert 0.63 <= low <= 0.73
        assert 0.92 <= high <= 0.98
    stated, stderr = (float(number) for number in _stated(name, count))
    assert errors.mean() == pytest.approx(stated, abs=3 * np.hypot(stderr, errors.std(ddof=1) / np.sqrt(splits)))


def test_last_presses_of_a_session_from_the_first(skins):
    for name, limit_mm in (("no_pattern", 3.0), ("parallel_lines", 3.0)):
        found = try_presses(skins(name).labelled(), np.arange(400), np.arange(2100, 2500))
        assert found.error_mm.mean() <= limit_mm
        assert (found.inside.mean(axis=0) >= [0.63, 0.90]).all()


@pytest.mark.parametrize("timed", [True, False])
@pytest.mark.parametrize("name", GOALS)
def test_nine_presses_later_tell_where_the_readings_have_gone(skins, name, timed):
    """Mean over random draws of the nine: the page states what is found, and regions are not too small.

    At most 73 % are required in the smaller ones, which is not reached without times (79 % on the patterned skin).
    Presses stand in their order; the gap of time may be told.
    """
    skin, located = skins(name), np.arange(2100, 2500)
    held = []
    for seed in range(RE_CHECKS):
        rechecks = np.random.default_rng([99, seed]).permutation(100)[:9] + 2000
        rows = np.append(np.arange(400), np.sort(rechecks))
        model = learn_place(
            skin.changes[rows], skin.labels_mm[rows], skin.pairs, 16, time_s=10.0 * rows if timed else None
        ).model
        locate = PlaceEstimator(model)
        places = locate(skin.changes[located])
        ratio = mahalanobis(skin.labels_mm[located] - places.place_mm, places.covariance_mm2)
        held.append([(ratio <= locate.q68).mean(), (ratio <= locate.q95).mean()])
    held = 100 * np.array(held)
    low, high = held.mean(axis=0)
    stderr = held.std(axis=0, ddof=1) / np.sqrt(RE_CHECKS)
    assert low >= 63
    if timed:
        assert low <= 73 + stderr[0]
    assert 92 <= high <= 98
    row = re.search(
        rf"^\| re-check with{'' if timed else 'out'} times \|.*\n\| in their regions \|(.*)\|$", PAGE, re.M
    ).group(1)
    cell = row.split("|")[list(GOALS).index(name)]
    stated = [float(number) for number in re.fullmatch(r" ([\d.]+) ± [\d.]+, ([\d.]+) ± [\d.]+ % ", cell).groups()]
    assert np.all(np.abs(np.subtract(stated, [low, high])) <= 0.5 + 3 * stderr)


def _stated(name, count):
    row = re.search(rf"^\| {name.replace('_', ' ')} \|(.*)\|$", PAGE, re.M).group(1).split("|")
    cell = row[[9, 39, 100, 400, 1600].index(count)]
    return re.fullmatch(r" ([\d.]+) ± ([\d.]+) .*", cell).groups()
