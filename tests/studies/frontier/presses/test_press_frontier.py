"""``frontier --recording``: draws, their errors, what is recommended and refused, where errors are known."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from pressed_sheets import SKIN_TOML, pressed_sheet

from cbsr_qa.cli.main import run_guarded
from cbsr_qa.domain.errors import CalibrationError, RefusedError
from cbsr_qa.studies.frontier.point import Accuracy, Point, TimeBasis
from cbsr_qa.studies.frontier.presses import study
from cbsr_qa.studies.frontier.presses.needed import COVERED, PLACE, extrapolate_presses, recommend_presses
from cbsr_qa.studies.frontier.presses.study import AT_RANDOM, IN_ORDER, numbers_of, press_frontier
from cbsr_qa.studies.frontier.presses.trial import Trial

NUMBERS = (9, 18, 36, 72, 144, 288)


def points(error_mm, stderr=0.03, seed=None):
    """Errors of a law, with relative standard errors; drawn from these with a seed."""
    random = np.random.default_rng(seed)
    return [
        Point(
            TimeBasis.PRESSES, AT_RANDOM, {"presses": n},
            {PLACE: Accuracy(error_mm(n) * (1 if seed is None else np.exp(stderr * random.standard_normal())),
                             stderr * error_mm(n), "mm")},
            1e-3, None, 5,
        )
        for n in NUMBERS
    ]  # fmt: skip


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
    assert numbers_of(11) == [6]
    for total in (14, 15, 40, 100, 2500, 10**5):
        numbers = numbers_of(total)
        assert numbers[0] == 9 or len(numbers) == 1
        assert total - numbers[-1] >= max(5, 0.19 * total)
        assert all(1 <= after / before < 3 for before, after in pairwise(numbers))
    with pytest.raises(RefusedError, match="10 presses are too few to leave any out"):
        numbers_of(10)


def test_nothing_located_was_learned_from_and_a_session_is_cut_by_time(labelled, trials):
    swept = press_frontier(labelled)
    time_s = labelled.presses.time_s
    for given, learned, located in trials:
        assert not set(learned) & set(located)
        if given.presses.time_s is not None:
            assert time_s[learned].max() < time_s[located].min()
    assert {point.series for point in swept.points} == {AT_RANDOM, IN_ORDER}
    first = [learned.tolist() for _, learned, _ in trials]
    press_frontier(labelled)
    assert [learned.tolist() for _, learned, _ in trials[len(first) :]] == first
    assert len({tuple(rows) for rows in first}) == len(first)


def test_no_place_that_was_learned_from_is_located(labelled, trials):
    """Twenty places pressed three times each, in rounds: after the first nine presses eleven places are new."""
    rounds = np.tile(np.arange(20), 3)
    presses = replace(labelled.presses, place_mm=labelled.presses.place_mm[rounds], time_s=np.arange(60.0))
    swept = press_frontier(replace(labelled, presses=presses))
    assert {point.series for point in swept.points} == {AT_RANDOM, IN_ORDER}
    for _, learned, located in trials:
        assert len(located) >= 5
        assert not set(rounds[learned]) & set(rounds[located])


def test_presses_that_change_nothing_are_left_out_and_counted(labelled, trials):
    changes = labelled.readings.changes.copy()
    changes[[3, 40]] = 0
    swept = press_frontier(replace(labelled, readings=replace(labelled.readings, changes=changes)), quick=True)
    assert {point.note for point in swept.points} == {"2 presses without a change of any reading left out"}
    assert all(given.readings.changes.any(axis=1).all() for given, _, _ in trials)


def test_errors_fall_as_they_do_and_time_is_that_of_the_table(labelled, trials):
    swept = press_frontier(labelled)
    for point in swept.points:
        number, error = point.knobs["presses"], point.accuracy[PLACE]
        assert error.value == pytest.approx(12 / np.sqrt(number), abs=4 * error.stderr)
        assert point.accuracy["covered_68"].value == pytest.approx(0.68, abs=4 * point.accuracy["covered_68"].stderr)
        assert point.station_s == pytest.approx(4 * number)
    assert press_frontier(labelled, 1.9, quick=True).recommended.setting == {"presses": 48}
    assert press_frontier(labelled, 3.5, quick=True).recommended.setting == {"presses": 21}


def test_standard_errors_are_the_scatter_of_means_over_other_presses(labelled, monkeypatch):
    """Draws that scatter by 0.3 about presses that scatter by 1, over tables of 60 presses."""
    random, found = np.random.default_rng(5), []
    for _ in range(60):
        of_press = 5 + random.standard_normal(60)
        monkeypatch.setattr(
            study,
            "try_presses",
            lambda _labelled, _learned, located, of_press=of_press: Trial(
                located, of_press[located] + 0.3 * random.standard_normal(), np.ones((len(located), 2), bool),
                np.ones(len(located), bool), 1.0, 1e-3,
            ),
        )  # fmt: skip
        found.append(press_frontier(labelled).points[0].accuracy[PLACE])
    scatter = np.std([each.value for each in found], ddof=1)
    assert np.mean([each.stderr for each in found]) == pytest.approx(scatter, rel=0.35)


def test_draws_that_teach_nothing_are_noted_and_none_at_all_is_refused(labelled, trials, monkeypatch):
    def refused(labelled, learned, located):
        raise CalibrationError("all presses are at one place")

    whole = study.try_presses
    monkeypatch.setattr(study, "try_presses", lambda *given: (refused if given[1][0] % 2 else whole)(*given))
    first = press_frontier(labelled).points[0]
    assert 0 < first.seeds < 20
    assert first.note.startswith(f"nothing learned from {20 - first.seeds} of 20 draws: all presses are at one place")
    monkeypatch.setattr(study, "try_presses", refused)
    with pytest.raises(RefusedError, match="nothing can be learned from any draw of these presses: all presses are"):
        press_frontier(labelled)


@pytest.mark.parametrize(("target_mm", "presses"), [(3.2, 18), (2.9, 36), (None, 288)])
def test_the_fewest_presses_that_reach_a_target_are_recommended(target_mm, presses):
    """Errors are 12.9/√n; 3.04 ± 0.09 mm of 18 presses reaches 3.2 mm but not 2.9 mm."""
    assert recommend_presses(points(lambda n: 12.9 / np.sqrt(n)), target_mm).setting == {"presses": presses}


def test_without_a_target_presses_that_buy_nothing_are_not_recommended():
    assert recommend_presses(points(lambda n: 2 + 30 * (n < 30)), None).setting == {"presses": 36}


def test_regions_that_do_not_hold_are_named_with_the_number_that_is_recommended():
    tried = points(lambda n: 12.9 / np.sqrt(n))
    tight = [
        replace(point, accuracy={**point.accuracy, COVERED["68"]: Accuracy(0.57, 0.02, "1", "stated")})
        for point in tried
    ]
    assert "regions of 68 % hold 57.0 ± 2.0 %, so errors" in recommend_presses(tight, 3.2).why
    assert "regions" not in recommend_presses(tried, 3.2).why


def test_a_power_law_is_extrapolated_within_its_error():
    """1000 presses would reach 1 mm: the interval of one standard error holds that in about two of three sweeps."""

    def law(n):
        return (n / 1000) ** -0.4

    exact, words = extrapolate_presses(points(law), 1.0)
    assert exact.presses == 1000
    assert "0.40 ± " in words
    found = [extrapolate_presses(points(law, seed=seed), 1.0)[0] for seed in range(60)]
    held = [each.low <= 1000 <= each.high for each in found if each is not None]
    assert len(held) > 50
    assert 0.5 < np.mean(held) < 0.85


@pytest.mark.parametrize(
    ("error_mm", "target_mm", "why"),
    [
        (lambda n: np.hypot(1.5, 60 / n), 1.0, "no falling power law fits"),
        (lambda n: 2.0, 1.0, "no falling power law fits"),
        (lambda n: n**-0.2, 0.1, "too far to tell"),
    ],
)
def test_what_follows_no_law_or_is_too_far_is_not_extrapolated(error_mm, target_mm, why):
    recommended = recommend_presses(points(error_mm, 0.01), target_mm)
    assert recommended.setting is None
    assert recommended.needed is None
    assert why in recommended.why
    assert "do not reach" in recommended.why


def asked(folder, *options):
    files = (folder / name for name in ("readings.csv", "presses.csv", "pairs.csv", "T.toml"))
    pairs = zip(("--recording", "--presses", "--pattern", "--sensor-type"), files, strict=True)
    return ["frontier", *(str(part) for pair in pairs for part in pair), "--differences", *options]


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
        (("--recording", "r.csv"), "--recording needs --presses"),
        (("--recording", "r.csv", "--presses", "p.csv"), "--recording needs --sensor-type"),
        (("--recording", "r.csv", "--place-error", "2"), "--place-error is '2'"),
    ],
)
def test_options_that_do_not_go_together_are_refused(refusal, arguments, said):
    assert said in refusal("frontier", *arguments)
