"""Number of presses for a target error of place: among those tried, or by a power law if the errors follow one."""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from scipy.stats import chi2

from cbsr_qa.domain.numbers import Array
from cbsr_qa.report.tables import with_uncertainty
from cbsr_qa.studies.frontier.point import Accuracy, Point
from cbsr_qa.studies.frontier.recommend import Needed, Recommendation, joint_stderr

PLACE: Final = "place_error"
COVERED: Final = {"68": "covered_68", "95": "covered_95"}
#: Least number of points for a power law: two parameters, and two to contradict them.
_MIN_FITTED: Final = 4
#: Probability of deviations as large as a law's own, below which the law does not fit.
_FITS: Final = 0.05
#: Smallest ratio of the exponent to its standard error for errors that decrease.
_FALLS: Final = 2.0
#: Number of standard errors by which a region must hold less than it states to be reported.
_CLEARLY: Final = 2.0
#: Largest extrapolation, as a factor of the largest number tried.
_FURTHEST: Final = 8.0


def recommend_presses(points: Sequence[Point], target_mm: float | None) -> Recommendation:
    """Choose the smallest number of presses whose error plus its standard error meets the target.

    Without a target, the smallest that no larger number beats by more than their joint standard error.
    """
    points = sorted(points, key=_number)
    if not points:
        return Recommendation(None, None, None, "nothing was learned from presses drawn at random")
    largest = points[-1]
    best = min(points, key=lambda point: point.accuracy[PLACE].value)
    error = best.accuracy[PLACE]
    if target_mm is None:
        sufficient = [
            point
            for point in points
            if point.accuracy[PLACE].value <= error.value + joint_stderr(point.accuracy[PLACE], error)
        ]
        why = "the fewest that no larger number beats by more than the joint standard error"
        why += "; more presses may still be better" if sufficient[0] is largest else ""
    else:
        sufficient = [point for point in points if point.accuracy[PLACE].upper <= target_mm]
        target_words = f"whose error of place, with its standard error, is at most {target_mm:g} mm"
        why = f"the fewest of {len(points)} numbers that were tried {target_words}"
    if sufficient:
        loose_words = loose_regions(sufficient[0].accuracy)
        return Recommendation.from_point(
            sufficient[0], f"{why}; but {loose_words}, so errors are stated too small" if loose_words else why
        )
    assert target_mm is not None  # without a target the best itself is enough
    needed, extrapolation = extrapolate_presses(points, target_mm)
    reached = f"{_number(best)} of them leave {error.value:.2f} ± {error.stderr or 0.0:.2f} mm"
    why = f"these presses do not reach {target_mm:g} mm: {reached}; {extrapolation}"
    return Recommendation(None, None, None, why, needed=needed)


def loose_regions(accuracy: Mapping[str, Accuracy]) -> str:
    """Say which regions hold clearly fewer places than they state; empty where none do."""
    shares_by_level = ((level, accuracy[name]) for level, name in COVERED.items() if name in accuracy)
    return " and ".join(
        f"regions of {level} % hold {with_uncertainty(100 * share.value, 100 * (share.stderr or 0.0))} %"
        for level, share in shares_by_level
        if share.value + _CLEARLY * (share.stderr or 0.0) < float(level) / 100
    )


def extrapolate_presses(points: Sequence[Point], target_mm: float) -> tuple[Needed | None, str]:
    """Extrapolate errors to a target, and describe it; None if no power law fits, or the target is too far away.

    A law error = a n^(−b) is fitted to logarithms with their standard errors, from the smallest number from which it
    fits.
    """
    law = next(filter(None, (_power_law(points[first:]) for first in range(len(points)))), None)
    if law is None:
        return None, "how many would is not known: no falling power law fits the errors of the largest numbers"
    (power, offset), covariance, centre = law
    away = (np.log(target_mm) - offset) / power
    slope = -np.array([away, 1.0]) / power  # of that by both parameters
    stderr = np.sqrt(slope @ covariance @ slope)
    low, middle, high = (int(float(f"{np.exp(centre + away + k * stderr):.3g}")) for k in (-1, 0, 1))
    law_words = f"errors fall with the number to the power of −{-power:.2f} ± {np.sqrt(covariance[0, 0]):.2f}"
    if high > _FURTHEST * _number(points[-1]):
        return None, f"{law_words}, by which more than {_FURTHEST:g} times as many might be needed: too far to tell"
    description = f"{law_words}, by which about {middle} would ({low} to {high}: one standard error)"
    return Needed(middle, low, high), description


def _power_law(points: Sequence[Point]) -> tuple[Array, Array, float] | None:
    """Fit log error = p₀ (log n − c) + p₁ by weighted least squares.

    Returns
    -------
    p (2,), its covariance (2, 2) and c; None if the law does not fit or does not decrease.
    """
    errors = [point.accuracy[PLACE] for point in points]
    if len(points) < _MIN_FITTED or not all(error.stderr and error.value > 0 for error in errors):
        return None
    logs = np.log([_number(point) for point in points])
    log_errors = np.log([error.value for error in errors])
    weight = np.array([error.value / (error.stderr or 1.0) for error in errors])
    parameters, covariance = np.polyfit(logs - logs.mean(), log_errors, 1, w=weight, cov="unscaled")
    misfit = np.square(weight * (np.polyval(parameters, logs - logs.mean()) - log_errors)).sum()
    error_falls = -parameters[0] > _FALLS * np.sqrt(covariance[0, 0])
    return (
        (parameters, covariance, float(logs.mean()))
        if error_falls and chi2.sf(misfit, len(points) - 2) >= _FITS
        else None
    )


def _number(point: Point) -> int:
    return int(point.knobs["presses"])
