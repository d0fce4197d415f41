"""Number of presses for a wished error of place: among those tried, or by a power law if the errors follow one."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import chi2

from cbsr_qa.report import with_uncertainty
from cbsr_qa.studies.frontier.point import Accuracy, Point
from cbsr_qa.studies.frontier.recommend import joint_stderr
from cbsr_qa.studies.frontier.study import Needed, Recommendation

PLACE: Final = "place_error"
COVERED: Final = {"68": "covered_68", "95": "covered_95"}
#: Least number of points for a power law: two parameters, and two to contradict them.
_FEWEST_FITTED: Final = 4
#: A law fits unless deviations as large as its own are less probable than this.
_FITS: Final = 0.05
#: Least exponent, over its standard error, of errors that decrease.
_FALLS: Final = 2.0
#: Standard errors by which regions hold less than they state before that is said.
_CLEARLY: Final = 2.0
#: Extrapolation is limited to this factor of the largest number tried.
_FURTHEST: Final = 8.0


def recommended_presses(points: Sequence[Point], wish_mm: float | None) -> Recommendation:
    """Choose the smallest number of presses whose error plus its standard error meets the wish.

    Without a wish, the smallest that no larger number beats by more than their joint standard error.
    """
    points = sorted(points, key=_number)
    if not points:
        return Recommendation(None, None, None, "nothing was learned from presses drawn at random")
    best = min(points, key=lambda point: point.accuracy[PLACE].value)
    if wish_mm is None:
        enough = [point for point in points if _alike(point.accuracy[PLACE], best.accuracy[PLACE])]
        why = "the fewest that no larger number beats by more than the joint standard error"
        return _of(enough[0], f"{why}; more presses may still be better" if enough[0] is points[-1] else why)
    enough = [point for point in points if _surely_mm(point) <= wish_mm]
    if enough:
        asked = f"whose error of place, with its standard error, is at most {wish_mm:g} mm"
        return _of(enough[0], f"the fewest of {len(points)} numbers that were tried {asked}")
    error = best.accuracy[PLACE]
    why = (
        f"these presses do not reach {wish_mm:g} mm: {_number(best)} of them leave {error.value:.2f} ±"
        f" {error.stderr or 0.0:.2f} mm"
    )
    needed, words = needed_presses(points, wish_mm)
    return Recommendation(None, None, None, f"{why}; {words}", needed=needed)


def loose_regions(accuracy: Mapping[str, Accuracy]) -> str:
    """Say which regions hold clearly fewer places than they state; empty where none do."""
    held = ((level, accuracy[name]) for level, name in COVERED.items() if name in accuracy)
    return " and ".join(
        f"regions of {level} % hold {with_uncertainty(100 * share.value, 100 * (share.stderr or 0.0))} %"
        for level, share in held
        if share.value + _CLEARLY * (share.stderr or 0.0) < float(level) / 100
    )


def needed_presses(points: Sequence[Point], wish_mm: float) -> tuple[Needed | None, str]:
    """Extrapolate errors to a wish, and describe it; None if no power law fits, or the wish is too far away.

    A law error = a n^(−b) is fitted to logarithms with their standard errors, from the smallest number from which it
    fits.
    """
    law = next(filter(None, (_PowerLaw.of(points[first:]) for first in range(len(points)))), None)
    if law is None:
        return None, "how many would is not known: no falling power law fits the errors of the largest numbers"
    logarithm, stderr = law.presses_for(wish_mm)
    low, middle, high = (int(float(f"{np.exp(logarithm + away * stderr):.3g}")) for away in (-1, 0, 1))
    said = f"errors fall with the number to the power of −{law.exponent:.2f} ± {law.exponent_stderr:.2f}"
    most = _number(points[-1])
    if high > _FURTHEST * most:
        return None, f"{said}, by which more than {_FURTHEST:g} times as many might be needed: too far to tell"
    needed = Needed(middle, low, high)
    return (
        needed,
        f"{said}, by which about {needed.presses} would ({needed.low} to {needed.high}: one standard error)",
    )


@dataclass(frozen=True, slots=True, eq=False)
class _PowerLaw:
    """log error = p₀ + p₁ (log n − c), with the covariance of p."""

    centre: float
    parameters: np.ndarray[tuple[int], np.dtype[np.float64]]
    covariance: np.ndarray[tuple[int, int], np.dtype[np.float64]]

    @classmethod
    def of(cls, points: Sequence[Point]) -> "_PowerLaw | None":
        """Fit by weighted least squares; None if it does not fit or does not decrease."""
        errors = [point.accuracy[PLACE] for point in points]
        if len(points) < _FEWEST_FITTED or not all(error.stderr and error.value > 0 for error in errors):
            return None
        logs = np.log([_number(point) for point in points])
        weight = np.array([error.value / (error.stderr or 1.0) for error in errors])
        design = np.column_stack([np.ones(len(logs)), logs - logs.mean()]) * weight[:, None]
        wanted = np.log([error.value for error in errors]) * weight
        parameters, *_ = np.linalg.lstsq(design, wanted, rcond=None)
        misfit = float(((design @ parameters - wanted) ** 2).sum())
        law = cls(float(logs.mean()), parameters, np.linalg.inv(design.T @ design))
        fits = float(chi2.sf(misfit, len(points) - 2)) >= _FITS
        return law if fits and law.exponent > _FALLS * law.exponent_stderr else None

    @property
    def exponent(self) -> float:
        return -float(self.parameters[1])

    @property
    def exponent_stderr(self) -> float:
        return float(np.sqrt(self.covariance[1, 1]))

    def presses_for(self, error_mm: float) -> tuple[float, float]:
        """Logarithm of the number for an error, and its standard error to first order."""
        away = (np.log(error_mm) - self.parameters[0]) / self.parameters[1]
        slope = np.array([1.0, away]) / self.parameters[1]
        return self.centre + float(away), float(np.sqrt(slope @ self.covariance @ slope))


def _of(point: Point, why: str) -> Recommendation:
    if loose := loose_regions(point.accuracy):
        why = f"{why}; but {loose}, so errors are stated too small"
    return Recommendation(point.knobs, point.accuracy, point.station_s, why)


def _alike(one: Accuracy, best: Accuracy) -> bool:
    return one.value <= best.value + joint_stderr(one, best)


def _surely_mm(point: Point) -> float:
    error = point.accuracy[PLACE]
    return error.value + (error.stderr or 0.0)


def _number(point: Point) -> int:
    return int(point.knobs["presses"])
