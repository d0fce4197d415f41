"""Number of presses for a target error of place: among those tried, or by a law with a floor."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Final

from cbsr_qa.report.tables import with_uncertainty
from cbsr_qa.studies.frontier.point import Accuracy, Point
from cbsr_qa.studies.frontier.presses.law import MIN_POINTS, LearningCurve, fit_laws
from cbsr_qa.studies.frontier.recommend import Needed, Recommendation

PLACE: Final = "place_error"
COVERED: Final = {"68": "covered_68", "95": "covered_95"}
#: Confidence with which an error is below its target, or below that of guessing.
_CONFIDENCE: Final = 0.95
#: Number of standard errors by which a region must hold less than it states to be reported.
_CLEARLY: Final = 2.0
#: Largest number that is stated, as a factor of the largest number tried.
_FURTHEST: Final = 8.0
#: A target that is not reached with so many times the largest number tried cannot be reached.
_NEVER: Final = 1000.0


def recommend_presses(
    points: Sequence[Point], curve: LearningCurve | None, target_mm: float | None, guess_mm: float
) -> Recommendation:
    """Choose the smallest number of presses whose error is below the target, with a confidence of 95 %.

    Without a target, the smallest that no larger number beats by more than the standard error of the difference.
    Numbers that are not sure to be better than guessing are not chosen.

    Parameters
    ----------
    points : numbers of presses that were tried, drawn at random.
    curve : their errors, to forecast those of more presses; None if they cannot be resampled.
    guess_mm : error of guessing.
    """
    if not points:
        return Recommendation(None, None, None, "nothing was learned from presses drawn at random")
    useful = sorted((point for point in points if beats_guessing(point, guess_mm)), key=_number)
    best = min(points, key=lambda point: point.accuracy[PLACE].value)
    error = best.accuracy[PLACE]
    reached = f"{_number(best)} of them leave {with_uncertainty(error.value, error.stderr or 0.0)} mm"
    if not useful:
        why = f"no number of these presses is surely better than guessing, {guess_mm:.3g} mm: {reached}"
        return Recommendation(None, None, None, why)
    if target_mm is None:
        sufficient = [
            point
            for point in useful
            if point.accuracy[PLACE].value <= error.value + (error.subtract(point.accuracy[PLACE]).stderr or 0.0)
        ]
        why = "the fewest that no larger number beats by more than the standard error of the difference"
        why += "; more presses may still be better" if sufficient[0] is useful[-1] else ""
    else:
        sufficient = [point for point in useful if _is_below(point, target_mm)]
        limit = f"at most {target_mm:g} mm with {100 * _CONFIDENCE:g} % confidence"
        why = f"the fewest of {len(points)} numbers that were tried whose mean error of place is {limit}"
    if sufficient:
        loose_words = loose_regions(sufficient[0].accuracy)
        return Recommendation.from_point(
            sufficient[0], f"{why}; but {loose_words}, so errors are stated too small" if loose_words else why
        )
    assert target_mm is not None  # without a target the best itself is enough
    needed, forecast = forecast_presses(curve, target_mm)
    why = f"these presses are not sure to reach {target_mm:g} mm: {reached}; {forecast}"
    return Recommendation(None, None, None, why, needed=needed)


def beats_guessing(point: Point, guess_mm: float) -> bool:
    """Whether the error of place is below that of guessing, with a confidence of 95 %."""
    return _is_below(point, guess_mm)


def loose_regions(accuracy: Mapping[str, Accuracy]) -> str:
    """Say which regions hold clearly fewer places than they state; empty where none do."""
    shares_by_level = ((level, accuracy[name]) for level, name in COVERED.items() if name in accuracy)
    return " and ".join(
        f"regions of {level} % hold {with_uncertainty(100 * share.value, 100 * (share.stderr or 0.0))} %"
        for level, share in shares_by_level
        if share.value + _CLEARLY * (share.stderr or 0.0) < float(level) / 100
    )


def forecast_presses(curve: LearningCurve | None, target_mm: float) -> tuple[Needed | None, str]:
    """Forecast the presses that a target needs, and describe it; None if their errors tell nothing.

    Limits are stated up to eight times the largest number tried; beyond, only the lower one is.
    """
    unknown = "how many would is not known"
    if curve is None or len(curve.numbers) < MIN_POINTS:
        return None, f"{unknown}: that takes {MIN_POINTS} numbers of presses, with several draws"
    laws = fit_laws(curve)
    if laws is None:
        return None, f"{unknown}: the errors follow no law with a floor"
    low, best, high = laws.forecast_number(target_mm)
    largest = curve.numbers[-1]
    if low > _NEVER * largest:
        least, _, most = laws.forecast_error(_NEVER * largest)
        limits_mm = f"{_NEVER:.0f} times as many would leave {least:.3g} to {most:.3g} mm (95 % confidence)"
        return Needed(None, None, None, False), f"more presses of this kind cannot reach it: even {limits_mm}"
    furthest = _FURTHEST * largest
    presses = _round(best, round) if best <= furthest else None
    if high <= furthest:
        limits = _round(low, math.floor), _round(high, math.ceil)
        return Needed(presses, *limits, True), f"about {presses} would ({limits[0]} to {limits[1]}, 95 % confidence)"
    least_number = _round(min(low, furthest), math.floor)
    doubt = "and perhaps no number reaches it" if math.isinf(high) else "and how many is too far away to tell"
    return (
        Needed(presses, least_number, None, None),
        f"at least {least_number} would be needed (95 % confidence), {doubt}",
    )


def _round(number: float, rounded: Callable[[float], int]) -> int:
    """Round a number to three digits."""
    unit = 10.0 ** max(0, math.floor(math.log10(max(number, 1.0))) - 2)
    return int(rounded(number / unit) * unit)


def _is_below(point: Point, error_mm: float) -> bool:
    bound = point.accuracy[PLACE].upper_bound(_CONFIDENCE)
    return bound is not None and bound <= error_mm


def _number(point: Point) -> int:
    return int(point.knobs["presses"])
