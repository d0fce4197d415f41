"""Truth in fifty digits, worked out with mpmath from the very doubles a case was given.

Images are of sensors of any size: twenty million products are too many for mpmath. Products of matrices are split
into slices of 21 bits, whose products and sums are exact in doubles (Ozaki et al. 2012), and only the small system is
solved in fifty digits.
"""

from collections.abc import Iterable, Sequence
from typing import Any, Final

import numpy as np
from mpmath import mp
from numpy.typing import NDArray

from cbsr_qa.calibration.sheet import ResponseMap

Array = NDArray[np.float64]
#: In extended precision, 64 bits of mantissa.
Long = NDArray[np.longdouble]

#: Digits that truth is worked out with.
DIGITS: Final = 50

_BITS: Final = 21
_SLICES: Final = 5  # 105 bits below the largest entry of a row
_SUMMED: Final = 2048  # products of 42 bits each add up within 53 bits

#: Of the model of a response: variance of every load beside its own, and scales of the priors.
_LEAST_VARIANCE: Final = 1e-12
_USUAL_DEVIATION: Final = 0.2
_USUAL_SCATTER: Final = 0.02


def relative_error(computed: float, truth: Any) -> float:  # an mpmath number
    """Difference of a number from the truth over the truth's size; over 1 where the truth is zero."""
    with mp.workdps(DIGITS):
        size = abs(truth)
        return float(abs(mp.mpf(float(computed)) - truth) / (size if size else 1))


def largest_relative_error(computed: Iterable[float], truth: Iterable[Any]) -> float:
    """Largest relative error of several numbers, each against its own truth."""
    return max(relative_error(computed_value, exact) for computed_value, exact in zip(computed, truth, strict=True))


def apart(computed: Array, exact: Array) -> float:
    """‖x − x*‖/‖x*‖ of doubles."""
    return float(np.linalg.norm(computed - exact) / np.linalg.norm(exact))


def polygon_area(corners: NDArray[np.float64]) -> Any:  # an mpmath number
    """Area of a counterclockwise polygon (q, 2)."""
    with mp.workdps(DIGITS):
        points = [(mp.mpf(float(x)), mp.mpf(float(y))) for x, y in corners]
        following = points[1:] + points[:1]
        return sum((x0 * y1 - y0 * x1 for (x0, y0), (x1, y1) in zip(points, following, strict=True)), mp.mpf(0)) / 2


def circle_overlap(corners: NDArray[np.float64], centre: Sequence[float], radius: float) -> Any:
    """Area of a counterclockwise polygon (q, 2) inside a circle, by Green's theorem along its sides."""
    with mp.workdps(DIGITS):
        middle = mp.mpc(float(centre[0]), float(centre[1]))
        points = [mp.mpc(float(x), float(y)) - middle for x, y in corners]
        r = mp.mpf(float(radius))
        following = points[1:] + points[:1]
        return sum((_under_side(a, b, r) for a, b in zip(points, following, strict=True)), mp.mpf(0))


def _under_side(start: Any, end: Any, radius: Any) -> Any:
    """Signed area between the origin and a directed side, as far as it is inside a circle about the origin."""
    along = end - start
    length2 = abs(along) ** 2
    middle = -mp.re(start * mp.conj(along)) / length2
    under = radius**2 - mp.im(mp.conj(start) * along) ** 2 / length2
    half = mp.sqrt(under / length2) if under > 0 else mp.mpf(0)
    first, last = (min(max(share, mp.mpf(0)), mp.mpf(1)) for share in (middle - half, middle + half))
    enters, leaves = start + first * along, start + last * along
    turned = _angle(start, enters) if first > 0 else mp.mpf(0)
    turned += _angle(leaves, end) if last < 1 else mp.mpf(0)
    return (radius**2 * turned + mp.im(mp.conj(enters) * leaves)) / 2


def _angle(start: Any, end: Any) -> Any:
    return mp.arg(mp.conj(start) * end)


def exact_image(jacobian: Array, weights: Array, hyperparameter: float, variance: Array, readings: Array) -> Array:
    """Image (JᵀWJ + λ²R)⁻¹ JᵀWy with diagonal R, by its dual form in fifty digits.

    Right to some 1e-19 times κ, the condition number of W^½JR^−½ with λ among its singular values.

    Parameters
    ----------
    jacobian : (m, e). weights : (e,) diagonal of R. variance : (m,) diagonal of W⁻¹. readings : (m,) y.
    """
    root = np.sqrt(weights.astype(np.longdouble))
    scaled = jacobian.astype(np.longdouble) / root
    with mp.workdps(DIGITS):
        system = exact_gram(scaled)
        for row, own in enumerate(variance.tolist()):
            system[row][row] += mp.mpf(hyperparameter) ** 2 * mp.mpf(own)
        coefficients = mp.cholesky_solve(mp.matrix(system), mp.matrix(readings.tolist()))
        split = [_in_parts(value) for value in coefficients]
    parts = np.array(split, dtype=np.longdouble)  # (m, 3), each a double of what the ones before leave
    image: Array = ((scaled.T @ parts).sum(axis=1) / root).astype(np.float64)
    return image


def exact_gram(rows: Long) -> list[list[Any]]:
    """A Aᵀ of rows (m, e), entries in fifty digits: exact but for what lies 105 bits below a row's largest."""
    exponents = np.frexp(np.abs(rows).max(axis=1))[1]
    slices, rest = [], np.ldexp(rows, -exponents[:, None])
    for number in range(1, _SLICES + 1):
        part = np.round(np.ldexp(rest, number * _BITS))
        rest = rest - np.ldexp(part, -number * _BITS)
        slices.append(part.astype(np.float64))
    whole = [0] * (len(rows) * len(rows))  # A Aᵀ without its rows' exponents, in units of 2^−21(slices + 1)
    for total in range(_SLICES):  # slices i and j weigh 2^−21(i + j + 2)
        summed = np.zeros((len(rows), len(rows)), dtype=np.int64)
        for first in range(0, rows.shape[1], _SUMMED):
            here = slice(first, first + _SUMMED)
            for i in range(total + 1):
                summed += (slices[i][:, here] @ slices[total - i][:, here].T).astype(np.int64)
        shift = (_SLICES - 1 - total) * _BITS
        whole = [above + (here << shift) for above, here in zip(whole, summed.ravel().tolist(), strict=True)]
    powers = (exponents[:, None] + exponents - (_SLICES + 1) * _BITS).ravel().tolist()
    flat = [mp.ldexp(mp.mpf(value), power) for value, power in zip(whole, powers, strict=True)]
    return [flat[row * len(rows) : (row + 1) * len(rows)] for row in range(len(rows))]


def _in_parts(value: Any) -> tuple[float, float, float]:
    high = float(value)
    middle = float(value - high)
    return high, middle, float(value - high - middle)


def exact_line(x: Array, y: Array, stderr: Array) -> tuple[Any, Any]:
    """Slope and intercept of weighted least squares."""
    with mp.workdps(DIGITS):
        points = [
            (mp.mpf(float(a)), mp.mpf(float(b)), 1 / mp.mpf(float(s)) ** 2)
            for a, b, s in zip(x, y, stderr, strict=True)
        ]
        total = mp.fsum(w for _, _, w in points)
        x_mean = mp.fsum(w * a for a, _, w in points) / total
        y_mean = mp.fsum(w * b for _, b, w in points) / total
        size = mp.fsum(w * (a - x_mean) ** 2 for a, _, w in points)
        slope = mp.fsum(w * (a - x_mean) * (b - y_mean) for a, b, w in points) / size
        return slope, y_mean - slope * x_mean


def line_condition(x: Array, y: Array, stderr: Array) -> float:
    """Σ |x ∂s/∂x| + Σ |y ∂s/∂y| over |s|: what small relative changes of every place and value make of a slope s."""
    slope, intercept = exact_line(x, y, stderr)
    with mp.workdps(DIGITS):
        weight = [1 / mp.mpf(float(value)) ** 2 for value in stderr]
        places, values = ([mp.mpf(float(value)) for value in some] for some in (x, y))
        middle = mp.fsum(w * a for w, a in zip(weight, places, strict=True)) / mp.fsum(weight)
        size = mp.fsum(w * (a - middle) ** 2 for w, a in zip(weight, places, strict=True))
        moved = mp.fsum(
            w * (abs(a * (b - intercept - slope * a - slope * (a - middle))) + abs(b * (a - middle)))
            for w, a, b in zip(weight, places, values, strict=True)
        )
        return float(moved / size / abs(slope))


def map_condition(learned: ResponseMap, places_mm: Array, variance: Array) -> float:
    """Largest condition number of the loads' covariances, over the processes of a map."""
    conditions = []
    for process in learned.members:
        with mp.workdps(DIGITS):
            alike = np.array(_correlations(places_mm, places_mm, process.smooth, process.length_mm), dtype=np.float64)
        noise = variance + process.scatter**2 + _LEAST_VARIANCE
        conditions.append(float(np.linalg.cond(process.deviation**2 * alike + np.diag(noise))))
    return max(conditions)


def exact_map(
    learned: ResponseMap, places_mm: Array, values: Array, variance: Array, wanted_mm: Array
) -> tuple[list[Any], list[Any]]:
    """Mean and variance at places (w, 2) of the mixture of Gaussian processes with an unknown mean, from all n loads.

    Rasmussen & Williams 2006, equations 2.25, 2.26, 2.42 and 2.45; ``learned`` only says which processes were kept.
    """
    with mp.workdps(DIGITS):
        y = [mp.mpf(float(value)) for value in values]
        kinds = {(process.smooth, process.length_mm) for process in learned.members}
        alike = {kind: _correlations(places_mm, np.vstack([places_mm, wanted_mm]), *kind) for kind in kinds}
        processes = []
        for process in learned.members:
            noise = [mp.mpf(float(v)) + mp.mpf(process.scatter) ** 2 + _LEAST_VARIANCE for v in variance]
            processes.append(_process(alike[process.smooth, process.length_mm], mp.mpf(process.deviation), noise, y))
        scores = [
            score
            + mp.log(process.deviation)
            - mp.log1p((mp.mpf(process.deviation) / _USUAL_DEVIATION) ** 2)
            - mp.mpf(process.scatter) / _USUAL_SCATTER
            for process, (score, _, _) in zip(learned.members, processes, strict=True)
        ]
        top = max(scores)
        weights = [mp.exp(score - top) for score in scores]
        return _mixed([weight / mp.fsum(weights) for weight in weights], processes)


def _mixed(weights: list[Any], processes: Sequence[tuple[Any, list[Any], list[Any]]]) -> tuple[list[Any], list[Any]]:
    means, variances = [], []
    for place in range(len(processes[0][1])):
        mean = mp.fsum(w * process[1][place] for w, process in zip(weights, processes, strict=True))
        parts = (
            w * (process[2][place] + (process[1][place] - mean) ** 2)
            for w, process in zip(weights, processes, strict=True)
        )
        means.append(mean)
        variances.append(mp.fsum(parts))
    return means, variances


def _process(
    alike: list[list[Any]], deviation: Any, noise: list[Any], y: list[Any]
) -> tuple[Any, list[Any], list[Any]]:
    """Logarithm of the marginal likelihood, and means and variances at the wanted places, of one process."""
    count, square = len(y), deviation**2
    covariance = mp.matrix([[square * entry for entry in row[:count]] for row in alike]) + mp.diag(noise)
    root = mp.cholesky(covariance)
    ones, seen = (_forward(root, right) for right in ([mp.mpf(1)] * count, y))
    information = mp.fdot(ones, ones)
    level = mp.fdot(ones, seen) / information
    left = [b - level * a for a, b in zip(ones, seen, strict=True)]
    logarithms = mp.fsum(mp.log(root[i, i]) for i in range(count)) + mp.log(information) / 2
    means, variances = [], []
    for place in range(count, len(alike[0])):
        towards = _forward(root, [square * row[place] for row in alike])
        means.append(level + mp.fdot(towards, left))
        free = 1 - mp.fdot(ones, towards)
        variances.append(square - mp.fdot(towards, towards) + free**2 / information)
    return -mp.fdot(left, left) / 2 - logarithms, means, variances


def _correlations(places_mm: Array, others_mm: Array, smooth: bool, length_mm: float) -> list[list[Any]]:
    """Gaussian or Matérn 5/2 correlations of places."""
    length = mp.mpf(length_mm)
    rows = []
    for x, y in places_mm.tolist():
        apart = [mp.hypot(mp.mpf(x) - u, mp.mpf(y) - v) / length for u, v in others_mm.tolist()]
        far = [mp.sqrt(5) * r for r in apart]
        matern = [(1 + f + f**2 / 3) * mp.exp(-f) for f in far]
        rows.append([mp.exp(-(r**2) / 2) for r in apart] if smooth else matern)
    return rows


def _forward(root: Any, right: list[Any]) -> list[Any]:
    """Solve L z = b with an mpmath matrix L."""
    solved: list[Any] = []
    for i, value in enumerate(right):
        solved.append((value - mp.fdot((root[i, j], known) for j, known in enumerate(solved))) / root[i, i])
    return solved


def mean_exponential(time_s: float, tau_s: float, ramp_s: float, frame_s: float) -> tuple[Any, Any]:
    """Value, and slope by log τ, of e^(−t/τ) after a ramp and averaged over a frame."""
    with mp.workdps(DIGITS):
        ramp, frame, at = (mp.mpf(float(seconds)) for seconds in (ramp_s, frame_s, time_s))

        def value(log_tau: Any) -> Any:
            tau = mp.exp(log_tau)
            over_ramp = tau / ramp * (1 - mp.exp(-ramp / tau))
            over_frame = tau / frame * (mp.exp(frame / tau / 2) - mp.exp(-frame / tau / 2))
            return mp.exp(-at / tau) * over_ramp * over_frame

        log_tau = mp.log(mp.mpf(tau_s))
        return value(log_tau), mp.diff(value, log_tau)
