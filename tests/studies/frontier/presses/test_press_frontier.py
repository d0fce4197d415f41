"""``frontier --recording``: draws, their errors, what is recommended and refused, where errors are known."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from pressed_sheets import SKIN_TOML, pressed_sheet

from cbsr_qa.calibration.presses.inputs import shift_rows
from cbsr_qa.cli.main import run_guarded
from cbsr_qa.domain.errors import CalibrationError, RefusedError
from cbsr_qa.domain.results.report import Figure
from cbsr_qa.studies.frontier.point import Accuracy, Point, TimeBasis
from cbsr_qa.studies.frontier.presses import study
from cbsr_qa.studies.frontier.presses.law import LearningCurve
from cbsr_qa.studies.frontier.presses.needed import COVERED, PLACE, recommend_presses
from cbsr_qa.studies.frontier.presses.report import lay_out_presses
from cbsr_qa.studies.frontier.presses.study import AT_RANDOM, IN_ORDER, list_numbers, study_presses
from cbsr_qa.studies.frontier.presses.trial import Trial

NUMBERS = (9, 18, 36, 72, 144, 288)
GUESS_MM = 26.0


def points(error_mm, stderr=0.03):
    """Errors of a law, with relative standard errors."""
    return [
        Point(
            TimeBasis.PRESSES, AT_RANDOM, {"presses": n},
            {PLACE: Accuracy(error_mm(n), stderr * error_mm(n), "mm")}, 1e-3, None, 5,
        )
        for n in NUMBERS
    ]  # fmt: skip


def curve(error_mm, stderr=0.03):
    """The same errors, to be forecast."""
    errors = np.array([error_mm(n) for n in NUMBERS])
    return LearningCurve(np.array(NUMBERS, float), errors, stderr**2 * np.eye(len(NUMBERS)), 50)


def recommended(error_mm, target_mm, stderr=0.03, guess_mm=GUESS_MM):
    return recommend_presses(points(error_mm, stderr), curve(error_mm, stderr), target_mm, guess_mm)


@pytest.fixture(scope="module")
def labelled():
    labelled = pressed_sheet(60, noise=0.05).labelled()
    times = 4.0 * np.random.default_rng(3).permutation(60)
    return replace(labelled, presses=replace(labelled.presses, time_s=times))


@pytest.fixture
def trials(monkeypatch):
    """Replace learning by errors of 12 mm over the root of the presses; return what was learned from and located."""
    asked = []

    def trial(labelled, learned, located):
        asked.append((labelled, learned, located))
        random = np.random.default_rng([len(learned), int(learned.sum())])
        error = 12 / np.sqrt(len(learned)) * random.uniform(0.5, 1.5, len(located))
        inside = random.uniform(size=(len(located), 1)) < [0.68, 0.95]
        return Trial(located, error, inside, np.ones(len(located), bool), 2.0, 1e-3)

    monkeypatch.setattr(study, "try_presses", trial)
    return asked


def test_numbers_double_and_leave_a_fifth_to_be_located():
    assert list_numbers(11) == [6]
    for total in (14, 15, 40, 100, 2500, 10**5):
        numbers = list_numbers(total)
        assert numbers[0] == 9 or len(numbers) == 1
        assert total - numbers[-1] >= max(5, 0.19 * total)
        assert all(1 <= after / before < 3 for before, after in pairwise(numbers))
    with pytest.raises(RefusedError, match="10 presses are too few to leave any out"):
        list_numbers(10)


def test_nothing_located_was_learned_from_and_a_session_is_cut_by_time(labelled, trials):
    swept = study_presses(labelled)
    time_s = labelled.presses.time_s
    for given, learned, located in trials:
        assert not set(learned) & set(located)
        if given.presses.time_s is not None:
            assert time_s[learned].max() < time_s[located].min()
    assert {point.series for point in swept.points} == {AT_RANDOM, IN_ORDER}
    first = [learned.tolist() for _, learned, _ in trials]
    study_presses(labelled)
    assert [learned.tolist() for _, learned, _ in trials[len(first) :]] == first
    assert len({tuple(rows) for rows in first}) == len(first)


def test_no_place_that_was_learned_from_is_located(labelled, trials):
    """Twenty places pressed three times each, in rounds: after the first nine presses eleven places are new."""
    rounds = np.tile(np.arange(20), 3)
    presses = replace(labelled.presses, place_mm=labelled.presses.place_mm[rounds], time_s=np.arange(60.0))
    swept = study_presses(replace(labelled, presses=presses))
    assert {point.series for point in swept.points} == {AT_RANDOM, IN_ORDER}
    for _, learned, located in trials:
        assert len(located) >= 5
        assert not set(rounds[learned]) & set(rounds[located])


def test_presses_that_change_nothing_are_left_out_and_counted(labelled, trials):
    changes = labelled.readings.changes.copy()
    changes[[3, 40]] = 0
    swept = study_presses(replace(labelled, readings=replace(labelled.readings, changes=changes)), quick=True)
    assert {point.note for point in swept.points} == {"2 presses without a change of any reading left out"}
    assert all(given.readings.changes.any(axis=1).all() for given, _, _ in trials)


def test_errors_fall_as_they_do_and_time_is_that_of_the_table(labelled, trials):
    swept = study_presses(labelled)
    for point in swept.points:
        number, error = point.knobs["presses"], point.accuracy[PLACE]
        assert error.value == pytest.approx(12 / np.sqrt(number), abs=4 * error.stderr)
        assert point.accuracy["covered_68"].value == pytest.approx(0.68, abs=4 * point.accuracy["covered_68"].stderr)
        assert point.station_s == pytest.approx(4 * number)
    assert study_presses(labelled, 1.9, quick=True).recommended.setting == {"presses": 48}
    assert study_presses(labelled, 3.5, quick=True).recommended.setting == {"presses": 21}


def test_standard_errors_are_the_scatter_of_means_over_other_presses(labelled, monkeypatch):
    """Of 60 presses, each teaches something else and is located by another error: tables of others scatter so."""
    random, swept = np.random.default_rng(5), []
    for _ in range(60):
        located_mm, taught = 5 + random.standard_normal(60), 0.6 * random.standard_normal(60)
        monkeypatch.setattr(
            study,
            "try_presses",
            lambda _labelled, learned, located, located_mm=located_mm, taught=taught: Trial(
                located, located_mm[located] * np.exp(taught[learned].mean()), np.ones((len(located), 2), bool),
                np.ones(len(located), bool), 1.0, 1e-3,
            ),
        )  # fmt: skip
        swept.append(study_presses(labelled, quick=len(swept) % 2 == 0).points)
    for number in range(3):  # of numbers drawn at random
        places = [points[number].accuracy[PLACE] for points in swept]
        scatter = np.std([place.value for place in places], ddof=1)
        assert np.mean([place.stderr for place in places]) == pytest.approx(scatter, rel=0.3)


def test_draws_that_teach_nothing_are_noted_and_none_at_all_is_refused(labelled, trials, monkeypatch):
    def refused(labelled, learned, located):
        raise CalibrationError("all presses are at one place")

    whole = study.try_presses
    monkeypatch.setattr(study, "try_presses", lambda *given: (refused if given[1][0] % 2 else whole)(*given))
    first = study_presses(labelled).points[0]
    assert 0 < first.seeds < 20
    assert first.note.startswith(f"nothing learned from {20 - first.seeds} of 20 draws: all presses are at one place")
    monkeypatch.setattr(study, "try_presses", refused)
    with pytest.raises(RefusedError, match="nothing can be learned from any draw of these presses: all presses are"):
        study_presses(labelled)


@pytest.mark.parametrize(("target_mm", "presses"), [(3.2, 18), (2.9, 36), (None, 288)])
def test_the_fewest_presses_that_reach_a_target_are_recommended(target_mm, presses):
    """Errors are 12.9/√n; 3.04 ± 0.09 mm of 18 presses is surely below 3.2 mm but not below 2.9 mm."""
    assert recommended(lambda n: 12.9 / np.sqrt(n), target_mm).setting == {"presses": presses}


def test_a_target_within_the_errors_is_not_reached():
    """2.98 ± 0.09 mm may be more than 3 mm; with 95 % confidence it is below 3.13 mm."""
    assert recommended(lambda n: 2.98 + 5 * (n < 288), 3.12).setting is None
    assert recommended(lambda n: 2.98 + 5 * (n < 288), 3.14).setting == {"presses": 288}


def test_without_a_target_presses_that_buy_nothing_are_not_recommended():
    assert recommended(lambda n: 2 + 20 * (n < 30), None).setting == {"presses": 36}


def test_what_is_no_better_than_guessing_is_not_recommended():
    assert recommended(lambda n: 14.1, None, guess_mm=14.0).setting is None
    found = recommended(lambda n: 14.1, 20.0, guess_mm=14.5)
    assert found.setting is None
    assert (
        "no number of these presses is surely better than guessing, 14.5 mm: 9 of them leave 14.1 ± 0.4 mm"
        in found.why
    )
    assert recommended(lambda n: 15 - 8 * (n > 40), 20.0, guess_mm=14.0).setting == {"presses": 72}


def test_regions_that_do_not_hold_are_named_with_the_number_that_is_recommended():
    tried = points(lambda n: 12.9 / np.sqrt(n))
    tight = [
        replace(point, accuracy={**point.accuracy, COVERED["68"]: Accuracy(0.57, 0.02, "1", "stated")})
        for point in tried
    ]
    assert "regions of 68 % hold 57.0 ± 2.0 %, so errors" in recommend_presses(tight, None, 3.2, GUESS_MM).why
    assert "regions" not in recommend_presses(tried, None, 3.2, GUESS_MM).why


def test_presses_for_a_target_near_by_are_forecast_with_limits():
    found = recommended(lambda n: 12.9 / np.sqrt(n), 0.6, stderr=0.01)
    assert found.setting is None
    assert found.needed.reachable
    assert found.needed.low < (12.9 / 0.6) ** 2 < found.needed.high
    assert f"about {found.needed.presses} would ({found.needed.low} to {found.needed.high}, 95 % c" in found.why


def test_of_a_target_far_away_only_the_least_number_is_stated():
    found = recommended(lambda n: 12.9 / np.sqrt(n), 0.2, stderr=0.01)
    assert (found.needed.reachable, found.needed.high) == (None, None)
    assert 288 < found.needed.low < (12.9 / 0.2) ** 2
    assert f"at least {found.needed.low} would be needed" in found.why


def test_a_target_below_the_floor_cannot_be_reached():
    found = recommended(lambda n: np.hypot(2.5, 20 / n), 1.5, stderr=0.01)
    assert (found.needed.presses, found.needed.low, found.needed.high, found.needed.reachable) == (
        None,
        None,
        None,
        False,
    )
    assert "more presses of this kind cannot reach it: even 1000 times as many would leave 2.3" in found.why


@pytest.mark.parametrize(
    ("tried", "why"),
    [
        (curve(lambda n: 2.0 + 3 * (n == 72)), "the errors follow no law with a floor"),
        (curve(lambda n: 12.9 / np.sqrt(n)).from_number(3), "that takes 4 numbers of presses, with several draws"),
        (None, "that takes 4 numbers of presses, with several draws"),
    ],
)
def test_what_errors_do_not_tell_is_not_known(tried, why):
    found = recommend_presses(points(lambda n: 2.0), tried, 1.0, GUESS_MM)
    assert (found.setting, found.needed) == (None, None)
    assert f"how many would is not known: {why}" in found.why


def test_guessing_is_stated_and_what_is_no_better_is_not_worth_it(labelled, trials, monkeypatch):
    """Nine presses are off by 44 mm, more than their spread; 21 by 19 mm."""

    def trial(labelled, learned, located):
        error = np.random.default_rng(int(learned.sum())).uniform(0.5, 1.5, len(located)) * 400 / len(learned)
        return Trial(located, error, np.ones((len(located), 2), bool), np.ones(len(located), bool), 2.0, 1e-3)

    monkeypatch.setattr(study, "try_presses", trial)
    swept = study_presses(labelled)
    assert 25 < swept.guess_mm < 35
    for point in swept.points:
        assert point.pareto == (point.knobs["presses"] > 12), point
    outcome = lay_out_presses(swept, "readings.csv")
    (guessing,) = (value for name, value in outcome.page.identity if name == "Guessing")
    assert guessing.startswith(f"{swept.guess_mm:.3g} mm")
    assert "guessing" in next(block for block in outcome.sections[0].blocks if isinstance(block, Figure)).svg()


def test_rows_out_of_step_are_named_and_shifted_back(labelled, trials, monkeypatch):
    """The simulated sheet tells by its readings that places stand a row below; learning itself is made up."""
    monkeypatch.setattr(study, "DOUBTFUL_SHARE", 0.0)
    place_mm = np.roll(labelled.presses.place_mm, 1, axis=0)
    shifted = replace(labelled, presses=replace(labelled.presses, place_mm=place_mm))
    assert "give --row-shift 1" in study_presses(shifted, quick=True).recommended.why
    assert "row" not in study_presses(shift_rows(shifted, 1), quick=True).recommended.why


def asked(folder, *options):
    files = (folder / name for name in ("readings.csv", "presses.csv", "pairs.csv", "T.toml"))
    pairs = zip(("--recording", "--presses", "--pattern", "--sensor-type"), files, strict=True)
    return ["frontier", *(str(part) for pair in pairs for part in pair), "--differences", *options]


@pytest.mark.parametrize(("options", "count"), [((), 20), (("--row-shift", "1"), 19), (("--row-shift", "-2"), 18)])
def test_rows_are_shifted_as_by_calibrate(tmp_path, monkeypatch, refusal, options, count):
    pressed_sheet(20, noise=0.05).write(tmp_path)
    (tmp_path / "T.toml").write_text(SKIN_TOML)
    seen = []

    def refused(labelled, target_mm, **_):
        seen.append(labelled)
        raise RefusedError("enough")

    monkeypatch.setattr(study, "study_presses", refused)
    assert "enough" in refusal(*asked(tmp_path, *options))
    assert len(seen[0].readings.changes) == len(seen[0].presses.place_mm) == count


@pytest.mark.rest
def test_presses_of_ones_own_are_learned_from_and_recommended(tmp_path, capsys):
    """From seven presses of a simulated sheet, five others are located within the spread of all."""
    pressed_sheet(12, seed=3, noise=0.02).write(tmp_path)
    (tmp_path / "T.toml").write_text(SKIN_TOML)
    page = tmp_path / "page.html"
    assert run_guarded(asked(tmp_path, "--quick", "--place-error", "40mm", "--json", "--output", str(page))) == 0
    document = json.loads(capsys.readouterr().out)
    (point,) = document["points"]
    assert (point["clock"], point["knobs"], point["seeds"]) == ("presses", {"presses": 7}, 3)
    assert 0 < point["accuracy"]["place_error"]["value"] < 30
    assert document["recommended"]["setting"] == {"presses": 7}
    assert "<svg" in page.read_text()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--recording", "r.csv", "--clock", "station"), "--clock is not for --recording"),
        (("--recording", "r.csv", "--recipe", "r.toml"), "--recipe is not for --recording"),
        (("--recording", "r.csv", "--presses", "p.csv", "--budget", "2h"), "--budget is not for --recording"),
        (("--place-error", "2mm"), "--place-error is for presses of your own, and --recording is missing"),
        (("--presses", "p.csv"), "--presses is for presses of your own"),
        (("--row-shift", "1"), "--row-shift is for presses of your own, and --recording is missing"),
        (("--recording", "r.csv"), "--recording needs --presses"),
        (("--recording", "r.csv", "--presses", "p.csv"), "--recording needs --sensor-type"),
        (("--recording", "r.csv", "--place-error", "2"), "--place-error is '2'"),
    ],
)
def test_options_that_do_not_go_together_are_refused(refusal, arguments, said):
    assert said in refusal("frontier", *arguments)
