"""Truth in fifty digits, computed with mpmath from the exact doubles of a case.

Images are of sensors of any size: twenty million products are too many for mpmath. Products of matrices are split
into slices of 21 bits, whose products and sums are exact in doubles (Ozaki et al. 2012), and only the small system is
solved in fifty digits.
"""

from collections.abc import Iterable, Sequence
from typing import Any, Final

import numpy as np
from mpmath import mp
from numpy.typing import NDArray

from cbsr_qa.calibration.sheet.response_map import ResponseMap
from cbsr_qa.domain.numbers import Array

#: Arrays of mpmath numbers.
_Exact = NDArray[np.object_]
#: Arrays of extended precision, 64 bits of mantissa.
Long = NDArray[np.longdouble]

#: Digits of truth.
DIGITS: Final = 50

_BITS: Final = 21
_SLICES: Final = 5  # 105 bits below the largest entry of a row
_SUMMED: Final = 2048  # products of 42 bits each add up within 53 bits

#: Model of a response: variance of every load besides its own, and scales of the priors.
_LEAST_VARIANCE: Final = 1e-12
_USUAL_DEVIATION: Final = 0.2
_USUAL_SCATTER: Final = 0.02


def relative_error(computed: float, truth: Any) -> float:  # an mpmath number
    """Relative difference of a number from the truth; absolute if the truth is zero."""
    with mp.workdps(DIGITS):
        size = abs(truth)
        return float(abs(mp.mpf(float(computed)) - truth) / (size if size else 1))


def largest_relative_error(computed: Iterable[float], truth: Iterable[Any]) -> float:
    """Largest relative error of several numbers, each relative to its own truth."""
    return max(relative_error(computed_value, exact) for computed_value, exact in zip(computed, truth, strict=True))


def relative_difference(computed: Array, exact: Array) -> float:
    """‖x − x*‖/‖x*‖ of doubles."""
    return float(np.linalg.norm(computed - exact) / np.linalg.norm(exact))


def polygon_area(corners: Array) -> Any:  # an mpmath number
    """Area of a counterclockwise polygon (q, 2)."""
    with mp.workdps(DIGITS):
        points = [(mp.mpf(float(x)), mp.mpf(float(y))) for x, y in corners]
        following = points[1:] + points[:1]
        return sum((x0 * y1 - y0 * x1 for (x0, y0), (x1, y1) in zip(points, following, strict=True)), mp.mpf(0)) / 2


def circle_overlap(corners: Array, centre: Sequence[float], radius: float) -> Any:
    """Area of a counterclockwise polygon (q, 2) inside a circle, by Green's theorem along its sides."""
    with mp.workdps(DIGITS):
        middle = mp.mpc(float(centre[0]), float(centre[1]))
        points = [mp.mpc(float(x), float(y)) - middle for x, y in corners]
        r = mp.mpf(float(radius))
        following = points[1:] + points[:1]
        return sum((_under_side(a, b, r) for a, b in zip(points, following, strict=True)), mp.mpf(0))


def _under_side(start: Any, end: Any, radius: Any) -> Any:
    """Signed area between the origin and a directed side, as far as inside a circle about the origin."""
    side = end - start
    length2 = abs(side) ** 2
    middle = -mp.re(start * mp.conj(side)) / length2
    half_chord2 = radius**2 - mp.im(mp.conj(start) * side) ** 2 / length2
    half_share = mp.sqrt(half_chord2 / length2) if half_chord2 > 0 else mp.mpf(0)
    first_share, last_share = (
        min(max(share, mp.mpf(0)), mp.mpf(1)) for share in (middle - half_share, middle + half_share)
    )
    enters, leaves = start + first_share * side, start + last_share * side
    turned = _angle(start, enters) if first_share > 0 else mp.mpf(0)
    turned += _angle(leaves, end) if last_share < 1 else mp.mpf(0)
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
        for row, row_variance in enumerate(variance.tolist()):
            system[row][row] += mp.mpf(hyperparameter) ** 2 * mp.mpf(row_variance)
        coefficients = mp.cholesky_solve(mp.matrix(system), mp.matrix(readings.tolist()))
        split = []
        for value in coefficients:
            high = float(value)
            middle = float(value - high)
            split.append((high, middle, float(value - high - middle)))
    # (m, 3), each a double of the remainder of the previous ones.
    coefficient_parts = np.array(split, dtype=np.longdouble)
    image: Array = ((scaled.T @ coefficient_parts).sum(axis=1) / root).astype(np.float64)
    return image


def exact_gram(rows: Long) -> list[list[Any]]:
    """A Aᵀ of rows (m, e), entries in fifty digits: exact except for parts 105 bits below a row's largest."""
    exponents = np.frexp(np.abs(rows).max(axis=1))[1]
    slices, remainder = [], np.ldexp(rows, -exponents[:, None])
    for number in range(1, _SLICES + 1):
        piece = np.round(np.ldexp(remainder, number * _BITS))
        remainder = remainder - np.ldexp(piece, -number * _BITS)
        slices.append(piece.astype(np.float64))
    scaled_products = [0] * (len(rows) * len(rows))  # A Aᵀ without its rows' exponents, in units of 2^−21(slices + 1)
    for total in range(_SLICES):  # slices i and j weigh 2^−21(i + j + 2)
        summed = np.zeros((len(rows), len(rows)), dtype=np.int64)
        for begin in range(0, rows.shape[1], _SUMMED):
            here = slice(begin, begin + _SUMMED)
            for i in range(total + 1):
                summed += (slices[i][:, here] @ slices[total - i][:, here].T).astype(np.int64)
        shift = (_SLICES - 1 - total) * _BITS
        scaled_products = [
            higher + (here << shift) for higher, here in zip(scaled_products, summed.ravel().tolist(), strict=True)
        ]
    powers = (exponents[:, None] + exponents - (_SLICES + 1) * _BITS).ravel().tolist()
    flat = [mp.ldexp(mp.mpf(value), power) for value, power in zip(scaled_products, powers, strict=True)]
    return [flat[row * len(rows) : (row + 1) * len(rows)] for row in range(len(rows))]


def exact_line(x: Array, y: Array, stderr: Array) -> tuple[Any, Any]:
    """Slope and intercept of weighted least squares."""
    with mp.workdps(DIGITS):
        a, b, errors = (_exact(values) for values in (x, y, stderr))
        w = 1 / errors**2
        a_mean, b_mean = (w @ a) / w.sum(), (w @ b) / w.sum()
        slope = w @ ((a - a_mean) * (b - b_mean)) / (w @ (a - a_mean) ** 2)
        return slope, b_mean - slope * a_mean


def line_condition(x: Array, y: Array, stderr: Array) -> float:
    """Σ |x ∂s/∂x| + Σ |y ∂s/∂y| over |s|: sensitivity of a slope s to relative changes of every place and value."""
    slope, intercept = exact_line(x, y, stderr)
    with mp.workdps(DIGITS):
        a, b, errors = (_exact(values) for values in (x, y, stderr))
        w = 1 / errors**2
        away = a - (w @ a) / w.sum()
        moved = w @ (np.abs(a * (b - intercept - slope * a - slope * away)) + np.abs(b * away))
        return float(moved / (w @ away**2) / abs(slope))


def map_condition(learned: ResponseMap, places_mm: Array, variance: Array) -> float:
    """Largest condition number of the loads' covariances, over the processes of a map."""
    conditions = []
    for process in learned.members:
        with mp.workdps(DIGITS):
            correlations = _correlations(places_mm, places_mm, process.smooth, process.length_mm).astype(np.float64)
        noise = variance + process.scatter**2 + _LEAST_VARIANCE
        conditions.append(float(np.linalg.cond(process.deviation**2 * correlations + np.diag(noise))))
    return max(conditions)


def exact_map(
    learned: ResponseMap, places_mm: Array, values: Array, variance: Array, wanted_mm: Array
) -> tuple[list[Any], list[Any]]:
    """Mean and variance at places (w, 2) of the mixture of Gaussian processes with an unknown mean, from all n loads.

    Rasmussen & Williams 2006, equations 2.25, 2.26, 2.42 and 2.45; ``learned`` only gives the processes that were
    kept.
    """
    with mp.workdps(DIGITS):
        kinds = {(process.smooth, process.length_mm) for process in learned.members}
        correlations_by_kind = {
            kind: _correlations(places_mm, np.vstack([places_mm, wanted_mm]), *kind) for kind in kinds
        }
        scores, means, variances = [], [], []
        for process in learned.members:
            deviation, scatter = mp.mpf(process.deviation), mp.mpf(process.scatter)
            noise = _exact(variance) + scatter**2 + _LEAST_VARIANCE
            score, mean, variance_of_process = _process(
                correlations_by_kind[process.smooth, process.length_mm], deviation, noise, _exact(values)
            )
            prior_penalty = mp.log1p((deviation / _USUAL_DEVIATION) ** 2) + scatter / _USUAL_SCATTER
            scores.append(score + mp.log(deviation) - prior_penalty)
            means.append(mean)
            variances.append(variance_of_process)
        weights = np.array([mp.exp(score - max(scores)) for score in scores], dtype=object)
        weights /= weights.sum()
        mean = weights @ np.array(means)
        return mean.tolist(), (weights @ (np.array(variances) + (np.array(means) - mean) ** 2)).tolist()


def _process(alike: _Exact, deviation: Any, noise: _Exact, y: _Exact) -> tuple[Any, _Exact, _Exact]:
    """Logarithm of the marginal likelihood, and means and variances at the given places, of one process."""
    count, square = len(y), deviation**2
    root = np.array(mp.cholesky(mp.matrix(square * alike[:, :count] + np.diag(noise))).tolist(), dtype=object)
    solved = _forward(root, np.column_stack([np.full(count, mp.one), y, square * alike[:, count:]]))
    whitened_ones, whitened_values, whitened_covariances = solved[:, 0], solved[:, 1], solved[:, 2:]
    information = whitened_ones @ whitened_ones
    level = whitened_ones @ whitened_values / information
    residuals = whitened_values - level * whitened_ones
    logarithms = mp.fsum(map(mp.log, root.diagonal())) + mp.log(information) / 2
    free = 1 - whitened_ones @ whitened_covariances
    variances = square - (whitened_covariances**2).sum(axis=0) + free**2 / information
    return -(residuals @ residuals) / 2 - logarithms, level + residuals @ whitened_covariances, variances


def _correlations(places_mm: Array, others_mm: Array, smooth: bool, length_mm: float) -> _Exact:
    """Gaussian or Matérn 5/2 correlations of places (n, o)."""
    steps = _exact(places_mm)[:, None] - _exact(others_mm)
    distance = np.frompyfunc(mp.hypot, 2, 1)(steps[..., 0], steps[..., 1]) / mp.mpf(length_mm)
    exponential, far = np.frompyfunc(mp.exp, 1, 1), mp.sqrt(5) * distance
    correlations: _Exact = exponential(-(distance**2) / 2) if smooth else (1 + far + far**2 / 3) * exponential(-far)
    return correlations


def _forward(root: _Exact, right: _Exact) -> _Exact:
    """Solve L z = B of a lower triangle."""
    solved = right.copy()
    for row, line in enumerate(root):
        solved[row] = (solved[row] - line[:row] @ solved[:row]) / line[row]
    return solved


def _exact(values: Array) -> _Exact:
    """The exact doubles, as numbers of any precision."""
    numbers: _Exact = np.frompyfunc(mp.mpf, 1, 1)(np.asarray(values, dtype=np.float64).astype(object))
    return numbers


def mean_exponential(time_s: float, tau_s: float, ramp_s: float, frame_s: float) -> tuple[Any, Any]:
    """Value, and slope by log τ, of e^(−t/τ) after a ramp and averaged over a frame."""
    with mp.workdps(DIGITS):
        ramp, frame, exact_time = (mp.mpf(float(seconds)) for seconds in (ramp_s, frame_s, time_s))

        def value(log_tau: Any) -> Any:
            tau = mp.exp(log_tau)
            over_ramp = tau / ramp * (1 - mp.exp(-ramp / tau))
            over_frame = tau / frame * (mp.exp(frame / tau / 2) - mp.exp(-frame / tau / 2))
            return mp.exp(-exact_time / tau) * over_ramp * over_frame

        log_tau = mp.log(mp.mpf(tau_s))
        return value(log_tau), mp.diff(value, log_tau)
