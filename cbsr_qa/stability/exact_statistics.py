"""Least squares and Gaussian processes in fifty digits, by their textbook formulas."""

from collections.abc import Sequence
from typing import Any, Final

import mpmath
import numpy as np
from numpy.typing import NDArray

from cbsr_qa.calibrate.response_map import ResponseMap
from cbsr_qa.stability.exact import DIGITS

Array = NDArray[np.float64]

#: Of the model of a response: variance of every load beside its own, and scales of the priors.
_LEAST_VARIANCE: Final = 1e-12
_USUAL_DEVIATION: Final = 0.2
_USUAL_SCATTER: Final = 0.02


def exact_line(x: Array, y: Array, stderr: Array) -> tuple[Any, Any]:
    """Slope and intercept of weighted least squares."""
    with mpmath.workdps(DIGITS):
        points = [
            (mpmath.mpf(float(a)), mpmath.mpf(float(b)), 1 / mpmath.mpf(float(s)) ** 2)
            for a, b, s in zip(x, y, stderr, strict=True)
        ]
        total = mpmath.fsum(w for _, _, w in points)
        x_mean = mpmath.fsum(w * a for a, _, w in points) / total
        y_mean = mpmath.fsum(w * b for _, b, w in points) / total
        size = mpmath.fsum(w * (a - x_mean) ** 2 for a, _, w in points)
        slope = mpmath.fsum(w * (a - x_mean) * (b - y_mean) for a, b, w in points) / size
        return slope, y_mean - slope * x_mean


def line_condition(x: Array, y: Array, stderr: Array) -> float:
    """Σ |x ∂s/∂x| + Σ |y ∂s/∂y| over |s|: what small relative changes of every place and value make of a slope s."""
    slope, intercept = exact_line(x, y, stderr)
    with mpmath.workdps(DIGITS):
        weight = [1 / mpmath.mpf(float(one)) ** 2 for one in stderr]
        places, values = ([mpmath.mpf(float(one)) for one in some] for some in (x, y))
        middle = mpmath.fsum(w * a for w, a in zip(weight, places, strict=True)) / mpmath.fsum(weight)
        size = mpmath.fsum(w * (a - middle) ** 2 for w, a in zip(weight, places, strict=True))
        moved = mpmath.fsum(
            w * (abs(a * (b - intercept - slope * a - slope * (a - middle))) + abs(b * (a - middle)))
            for w, a, b in zip(weight, places, values, strict=True)
        )
        return float(moved / size / abs(slope))


def map_condition(learned: ResponseMap, places_mm: Array, variance: Array) -> float:
    """Largest condition number of the loads' covariances, over the processes of a map."""
    found = []
    for one in learned.members:
        with mpmath.workdps(DIGITS):
            alike = np.array(_correlations(places_mm, places_mm, one.smooth, one.length_mm), dtype=np.float64)
        noise = variance + one.scatter**2 + _LEAST_VARIANCE
        found.append(float(np.linalg.cond(one.deviation**2 * alike + np.diag(noise))))
    return max(found)


def exact_map(
    learned: ResponseMap, places_mm: Array, values: Array, variance: Array, wanted_mm: Array
) -> tuple[list[Any], list[Any]]:
    """Mean and variance at places (w, 2) of the mixture of Gaussian processes with an unknown mean.

    Rasmussen & Williams 2006, equations 2.25, 2.26, 2.42 and 2.45, on all loads by themselves.

    Parameters
    ----------
    learned : says which processes were kept; nothing else is taken from it.
    places_mm, values, variance : (n, 2), (n,), (n,) of the loads.
    """
    with mpmath.workdps(DIGITS):
        y = [mpmath.mpf(float(value)) for value in values]
        kinds = {(one.smooth, one.length_mm) for one in learned.members}
        alike = {kind: _correlations(places_mm, np.vstack([places_mm, wanted_mm]), *kind) for kind in kinds}
        found = []
        for one in learned.members:
            noise = [mpmath.mpf(float(v)) + mpmath.mpf(one.scatter) ** 2 + _LEAST_VARIANCE for v in variance]
            found.append(_process(alike[one.smooth, one.length_mm], mpmath.mpf(one.deviation), noise, y))
        scores = [
            score
            + mpmath.log(one.deviation)
            - mpmath.log1p((mpmath.mpf(one.deviation) / _USUAL_DEVIATION) ** 2)
            - mpmath.mpf(one.scatter) / _USUAL_SCATTER
            for one, (score, _, _) in zip(learned.members, found, strict=True)
        ]
        top = max(scores)
        weights = [mpmath.exp(score - top) for score in scores]
        return _mixed([weight / mpmath.fsum(weights) for weight in weights], found)


def _mixed(weights: list[Any], found: Sequence[tuple[Any, list[Any], list[Any]]]) -> tuple[list[Any], list[Any]]:
    means, variances = [], []
    for place in range(len(found[0][1])):
        mean = mpmath.fsum(w * one[1][place] for w, one in zip(weights, found, strict=True))
        parts = (w * (one[2][place] + (one[1][place] - mean) ** 2) for w, one in zip(weights, found, strict=True))
        means.append(mean)
        variances.append(mpmath.fsum(parts))
    return means, variances


def _process(
    alike: list[list[Any]], deviation: Any, noise: list[Any], y: list[Any]
) -> tuple[Any, list[Any], list[Any]]:
    """Logarithm of the marginal likelihood, and means and variances at the wanted places, of one process."""
    count, square = len(y), deviation**2
    covariance = [[square * alike[i][j] + (noise[i] if i == j else 0) for j in range(count)] for i in range(count)]
    root = _root(covariance)
    ones, seen = (_forward(root, right) for right in ([mpmath.mpf(1)] * count, y))
    information = _inner(ones, ones)
    level = _inner(ones, seen) / information
    left = [b - level * a for a, b in zip(ones, seen, strict=True)]
    logarithms = mpmath.fsum(mpmath.log(root[i][i]) for i in range(count)) + mpmath.log(information) / 2
    means, variances = [], []
    for place in range(count, len(alike[0])):
        towards = _forward(root, [square * alike[i][place] for i in range(count)])
        means.append(level + _inner(towards, left))
        free = 1 - _inner(ones, towards)
        variances.append(square - _inner(towards, towards) + free**2 / information)
    return -_inner(left, left) / 2 - logarithms, means, variances


def _correlations(one: Array, other: Array, smooth: bool, length_mm: float) -> list[list[Any]]:
    """Gaussian or Matérn 5/2 correlations of places."""
    length = mpmath.mpf(length_mm)
    rows = []
    for x, y in one.tolist():
        apart = [mpmath.hypot(mpmath.mpf(x) - u, mpmath.mpf(y) - v) / length for u, v in other.tolist()]
        far = [mpmath.sqrt(5) * r for r in apart]
        matern = [(1 + f + f**2 / 3) * mpmath.exp(-f) for f in far]
        rows.append([mpmath.exp(-(r**2) / 2) for r in apart] if smooth else matern)
    return rows


def _root(matrix: list[list[Any]]) -> list[list[Any]]:
    """Cholesky factor, by rows."""
    root: list[list[Any]] = []
    for i, row in enumerate(matrix):
        new: list[Any] = []
        for j in range(i):
            new.append((row[j] - _inner(new, root[j][:j])) / root[j][j])
        new.append(mpmath.sqrt(row[i] - _inner(new, new)))
        root.append(new)
    return root


def _forward(root: list[list[Any]], right: list[Any]) -> list[Any]:
    """Solve L z = b."""
    solved: list[Any] = []
    for row, value in zip(root, right, strict=True):
        solved.append((value - _inner(solved, row[:-1])) / row[-1])
    return solved


def _inner(one: list[Any], other: list[Any]) -> Any:
    return mpmath.fsum(a * b for a, b in zip(one, other, strict=True))


def mean_exponential(time_s: float, tau_s: float, ramp_s: float, frame_s: float) -> tuple[Any, Any]:
    """Value, and slope by log τ, of e^(−t/τ) after a ramp and averaged over a frame."""
    with mpmath.workdps(DIGITS):
        ramp, frame, at = (mpmath.mpf(float(one)) for one in (ramp_s, frame_s, time_s))

        def value(log_tau: Any) -> Any:
            tau = mpmath.exp(log_tau)
            over_ramp = tau / ramp * (1 - mpmath.exp(-ramp / tau))
            over_frame = tau / frame * (mpmath.exp(frame / tau / 2) - mpmath.exp(-frame / tau / 2))
            return mpmath.exp(-at / tau) * over_ramp * over_frame

        log_tau = mpmath.log(mpmath.mpf(tau_s))
        return value(log_tau), mpmath.diff(value, log_tau)
