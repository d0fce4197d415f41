"""``cbsr-qa frontier --recording``: how accurate places become with the number of presses, and how many to make.

Every draw is registered and learned from its own presses alone, as ``cbsr-qa calibrate`` would do with these, so that
it uses no information from the presses that it locates. Registering takes half the time of a draw of 39 presses, and
a tenth of one of 400; registering once on all presses would save this time.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from cbsr_qa.calibration.place.held_out import visits_of
from cbsr_qa.calibration.place.learning import FEWEST_PRESSES
from cbsr_qa.calibration.presses.inputs import LabelledPresses
from cbsr_qa.calibration.presses.learning import DOUBTFUL_SHARE
from cbsr_qa.calibration.presses.row_order import find_row_order, guess_error
from cbsr_qa.domain.errors import CalibrationError, RecordingError, RefusedError
from cbsr_qa.domain.numbers import Array, Indices
from cbsr_qa.report.tables import plural
from cbsr_qa.studies.frontier.point import Accuracy, Better, Point, TimeBasis
from cbsr_qa.studies.frontier.presses.law import LearningCurve
from cbsr_qa.studies.frontier.presses.needed import COVERED, PLACE, beats_guessing, loose_regions, recommend_presses
from cbsr_qa.studies.frontier.presses.resampling import resample_errors
from cbsr_qa.studies.frontier.presses.trial import Trial, try_presses
from cbsr_qa.studies.frontier.study import Frontier
from cbsr_qa.studies.frontier.worth import mark_worth
from cbsr_qa.studies.sweep import Tell

AT_RANDOM: Final = "drawn at random"
IN_ORDER: Final = "first of the session, locating its last"
#: Smallest number of presses tried, unless there are too few; each further number is about twice as large.
_FIRST: Final = 9
#: Largest number of presses tried: the time of learning grows with its cube.
_MAX_PRESSES: Final = 2000
#: Least share and least number of the presses that are left out, and the largest number of them that are located.
_LEFT_OUT: Final = 0.2
_MIN_LOCATED: Final = 5
_MAX_LOCATED: Final = 500
#: Total of presses learned from over the draws of a number, and least and most draws: quick sweep (True) or whole.
_LEARNED: Final = {True: 100, False: 400}
_DRAWS: Final = {True: (1, 3), False: (2, 20)}

#: Series, presses (without times if drawn at random), and the rows learned from and located.
_Draw = tuple[str, LabelledPresses, Indices, Indices]


def study_presses(
    labelled: LabelledPresses,
    target_mm: float | None = None,
    *,
    quick: bool = False,
    tell: Tell = lambda done, of, what: None,
) -> Frontier:
    """Learn from growing numbers of presses, locate others, and recommend a number.

    Presses that change no reading are left out, and counted in a note. No press is located at a place that was
    learned from: presses repeated at one place are drawn or left out together.

    Parameters
    ----------
    target_mm : largest mean error of place; without it the smallest number is recommended that no larger one surely
        beats.
    quick : True for fewer draws, and for one number of presses of the session's first part.

    Raises
    ------
    RefusedError
        If the presses are too few to leave any out, or nothing can be learned from any draw.
    RecordingError
        If readings and labels do not match.
    """
    labelled.check()
    has_change = np.any(labelled.readings.changes != 0, axis=1)
    labelled = labelled.select(np.flatnonzero(has_change))
    draws = list(_draws(labelled, quick=quick))
    trials_by_draw: dict[tuple[str, int], list[Trial | str]] = {}
    for done, (series, presses, learned, located) in enumerate(draws):
        tell(done, len(draws), f"{len(learned)} presses, {series}")
        trials_by_draw.setdefault((series, len(learned)), []).append(_try_draw(presses, learned, located))
    tell(len(draws), len(draws), "")
    unchanged = int((~has_change).sum())
    note = f"{plural(unchanged, 'press', 'presses')} without a change of any reading left out" if unchanged else ""
    pace_s = _measure_pace(labelled)
    outcomes = [_point(*key, trials, pace_s, note) for key, trials in trials_by_draw.items()]
    points = [outcome for outcome in outcomes if isinstance(outcome, Point)]
    if not points:
        raise RefusedError(f"nothing can be learned from any draw of these presses: {outcomes[0]}")
    curve = _resample(trials_by_draw, labelled)
    if curve is not None:
        points = [_state_resampled_error(point, curve) for point in points]
    guess_mm = guess_error(labelled.presses.place_mm)
    points = mark_worth(
        points, lambda point: float(point.knobs["presses"]) if beats_guessing(point, guess_mm) else None, [PLACE]
    )
    at_random = [point for point in points if point.series == AT_RANDOM]
    recommendation = recommend_presses(at_random, curve, target_mm, guess_mm)
    if min(point.accuracy[PLACE].value for point in points) > DOUBTFUL_SHARE * guess_mm:
        order = find_row_order(labelled.readings.changes, labelled.presses.place_mm, row_shift=labelled.row_shift)
        why = [] if order is None else [order.words]
        recommendation = replace(recommendation, why="; ".join([*why, recommendation.why]))
    return Frontier(quick, tuple(points), recommendation, guess_mm)


def _measure_pace(labelled: LabelledPresses) -> float | None:
    """Return the median time from one press to the next; None without times."""
    time_s = labelled.presses.time_s
    if time_s is None or np.ptp(time_s) == 0:
        return None
    return float(np.median(np.diff(np.sort(time_s))))


def _resample(
    trials_by_draw: Mapping[tuple[str, int], Sequence[Trial | str]], labelled: LabelledPresses
) -> LearningCurve | None:
    """Return the errors of presses drawn at random, as far as something was learned from them."""
    completed = {
        number: [trial for trial in trials if isinstance(trial, Trial)]
        for (series, number), trials in trials_by_draw.items()
        if series == AT_RANDOM
    }
    return resample_errors(
        {number: trials for number, trials in completed.items() if trials}, _number_visits(labelled)
    )


def list_numbers(total: int) -> list[int]:
    """Numbers of presses to learn from where there are ``total``, each about twice the one before.

    RefusedError if there are too few to learn from some and locate others.
    """
    largest = min(_MAX_PRESSES, total - _holdout_count(total))
    if largest < FEWEST_PRESSES:
        raise RefusedError(
            f"{total} presses are too few to leave any out: {FEWEST_PRESSES} to learn from and {_MIN_LOCATED} to"
            " locate are needed",
            remedy="press at more places",
        )
    if largest <= _FIRST:
        return [largest]
    steps = max(1, round(float(np.log2(largest / _FIRST))))
    return [round(number) for number in np.geomspace(_FIRST, largest, steps + 1)]


def _draws(labelled: LabelledPresses, *, quick: bool) -> Iterator[_Draw]:
    visits, total = _number_visits(labelled), len(labelled.presses.place_mm)
    # Randomly drawn presses lie between those located, and need no drift.
    timeless = replace(labelled, presses=replace(labelled.presses, time_s=None))
    for learned, located in draw_rows(visits, quick=quick):
        yield AT_RANDOM, timeless, learned, located
    time_s = labelled.presses.time_s
    session = np.arange(total) if time_s is None else np.argsort(time_s, kind="stable")
    early_numbers = [number for number in list_numbers(total) if number <= total / 2]
    for number in early_numbers[-1:] if quick else early_numbers:
        learned, latest = session[:number], session[-_holdout_count(total) :][-_MAX_LOCATED:]
        latest = latest[~np.isin(visits[latest], visits[learned])]
        if len(latest) >= _MIN_LOCATED:
            yield IN_ORDER, labelled, learned, latest


def draw_rows(visits: Indices, *, quick: bool) -> Iterator[tuple[Indices, Indices]]:
    """Yield rows learned from and located, of draws at random from presses (n,) with the number of their place."""
    total = len(visits)
    for number in list_numbers(total):
        for split in range(int(np.clip(_LEARNED[quick] // number, *_DRAWS[quick]))):
            random = np.random.default_rng([*b"presses", number, split])
            located = _draw_places(visits, _holdout_count(total), random)
            learnable = random.permutation(np.setdiff1d(np.arange(total), located))
            yield learnable[:number], located[:_MAX_LOCATED]


def _number_visits(labelled: LabelledPresses) -> Indices:
    place_mm = labelled.presses.place_mm
    return visits_of(place_mm - place_mm.mean(axis=0))


def _holdout_count(total: int) -> int:
    """How many presses are left out at least."""
    return max(_MIN_LOCATED, round(_LEFT_OUT * total))


def _draw_places(visits: Indices, count: int, random: np.random.Generator) -> Indices:
    """All presses at places drawn at random, of which there are ``count`` or, where places repeat, a few more."""
    places, repeats = np.unique(visits, return_counts=True)
    order = random.permutation(len(places))
    drawn = int(np.searchsorted(repeats[order].cumsum(), count)) + 1
    return random.permutation(np.flatnonzero(np.isin(visits, places[order[:drawn]])))


def _try_draw(presses: LabelledPresses, learned: Indices, located: Indices) -> Trial | str:
    """Result of a draw, or why nothing could be learned from it."""
    try:
        return try_presses(presses, learned, located)
    except (RecordingError, CalibrationError) as error:
        return error.reason


def _point(series: str, number: int, trials: Sequence[Trial | str], pace_s: float | None, note: str) -> Point | str:
    """Combine the draws of a number, or return why nothing could be learned from any."""
    completed = [trial for trial in trials if isinstance(trial, Trial)]
    refusals = [trial for trial in trials if isinstance(trial, str)]
    if not completed:
        return refusals[0]
    refusal_note = f"nothing learned from {len(refusals)} of {len(trials)} draws: {refusals[0]}" if refusals else ""
    accuracy = {
        PLACE: _mean(completed, [trial.error_mm for trial in completed], "mm", "less"),
        COVERED["68"]: _mean(completed, [trial.inside[:, 0].astype(float) for trial in completed], "1", "stated"),
        COVERED["95"]: _mean(completed, [trial.inside[:, 1].astype(float) for trial in completed], "1", "stated"),
        "in_model": _mean(completed, [trial.in_model.astype(float) for trial in completed], "1", "more"),
    }
    return Point(
        TimeBasis.PRESSES,
        series,
        {"presses": number},
        accuracy,
        compute_s=float(np.median([trial.frame_s for trial in completed])),
        station_s=None if pace_s is None else number * pace_s,
        seeds=len(completed),
        note="; ".join(filter(None, (refusal_note, note, loose_regions(accuracy)))),
        costs={"learning_s": float(np.median([trial.learning_s for trial in completed]))},
    )


def _state_resampled_error(point: Point, curve: LearningCurve) -> Point:
    """Return a point of presses drawn at random with the standard error of the curve."""
    if point.series != AT_RANDOM:
        return point
    index = int(np.flatnonzero(curve.numbers == point.knobs["presses"])[0])
    place = point.accuracy[PLACE]
    stderr = place.value * float(np.sqrt(curve.covariance[index, index]))
    return replace(point, accuracy={**point.accuracy, PLACE: replace(place, stderr=stderr)})


def _mean(trials: Sequence[Trial], values: Sequence[Array], unit: str, better: Better) -> Accuracy:
    """Mean over draws, with a standard error of both: of draws, and of the presses that they locate.

    Draws locate the same presses repeatedly, and each press counts once: for k draws with a variance σ² within draws
    and s² of their means, it is √(max(0, s² − σ²/n)/k + σ²/N), where n presses are located in a draw and N different
    ones in all. One draw does not show how others would scatter.
    """
    means = [float(draw.mean()) for draw in values]
    within_variance = float(np.mean([draw.var(ddof=1) for draw in values]))
    press_count = len(np.unique(np.concatenate([draw.located for draw in trials])))
    between_variance = 0.0
    if len(means) > 1:
        between_variance = max(0.0, float(np.var(means, ddof=1)) - within_variance / len(trials[0].located))
    return Accuracy(
        float(np.mean(means)),
        float(np.sqrt(between_variance / len(means) + within_variance / press_count)),
        unit,
        better,
    )
