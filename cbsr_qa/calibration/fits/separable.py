"""Variable projection for sums of exponentials: the amplitudes are linear and not part of the search."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import fdtrc

from cbsr_qa.domain.numbers import Array

#: A second exponential is kept only if the probability of such a gain by chance is below this, if the time constants
#: differ by this factor, and if they are determined: standard errors of their logarithms are below this.
SIGNIFICANCE: Final = 0.01
SEPARATION: Final = 2.0
LOG_ERROR: Final = 0.5
#: Time constants tried on the log grid before the best are refined.
_GRID: Final = 24
#: Number of the best starts that are refined.
_STARTS: Final = 2
#: Most Gauss–Newton steps after a search.
_POLISHING: Final = 6
#: Most steps of a search; one along a curved valley takes about 30.
_STEPS: Final = 200
#: Relative damping a search begins with.
_DAMPING: Final = 1e-3
#: A search ends when a step would gain less than this share of the sum of squares, enough to find the best start.
_GAIN: Final = 1e-13
_NEAR: Final = 1e-8
_TINY: Final = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True, slots=True, eq=False)
class Exponentials:
    """A least-squares fit of a constant and k decaying exponentials.

    Parameters
    ----------
    time_constants_s : (k,) rising [s].
    coefficients : (1 + k,) offset and amplitudes at t = 0, in the unit of the values.
    residual : (n,) values − fit.
    stderr : (1 + 2 k,) standard errors of offset, amplitudes and logarithms of the time constants; infinite where
        undetermined.
    """

    time_constants_s: Array
    coefficients: Array
    residual: Array
    stderr: Array

    @property
    def sum_of_squares(self) -> float:
        return float(self.residual @ self.residual)


def fit_exponentials(
    time_s: Array,
    values: Array,
    count: int,
    bounds_s: tuple[float, float],
    rounding: float,
) -> Exponentials:
    """Fit a constant and one or two exponentials, started from the best places of a log grid of time constants.

    The search runs over log τ; at every point the amplitudes follow by QR of the centred basis (Golub & Pereyra 1973,
    with Kaufman's Jacobian), so that a large offset loses no digits and τ is positive by construction.

    Parameters
    ----------
    time_s, values : (n,) float64, n > 1 + 2 count.
    count : 1 or 2 exponentials.
    bounds_s : lowest and highest time constant.
    rounding : rms rounding error of the values, the lower bound of a fit's error.
    """
    centred = values - values.mean()
    scale = float(np.abs(centred).max()) or 1.0
    y = centred / scale
    lowest, highest = np.log(bounds_s)
    factors_by_key: dict[bytes, tuple[Array, Array, Array]] = {}

    def factors(log_tau: Array) -> tuple[Array, Array, Array]:
        """Basis and its QR; the last ones are cached, since a search requests slopes where it has been."""
        key = log_tau.tobytes()
        if key not in factors_by_key:
            factors_by_key.clear()
            basis = _basis(time_s, log_tau)
            factors_by_key[key] = (basis, *np.linalg.qr(_subtract_means(basis)))
        return factors_by_key[key]

    def residual(log_tau: Array) -> Array:
        _, q, _ = factors(log_tau)
        remainder: Array = y - q @ (q.T @ y)
        return remainder

    def jacobian(log_tau: Array) -> Array:
        basis, q, r = factors(log_tau)
        slope = _subtract_means(_slopes(time_s, basis, log_tau)) * _back_substitute(r, q.T @ y)
        return q @ (q.T @ slope) - slope

    best = best_fit(residual, jacobian, _starts(time_s, y, count, (lowest, highest)), (lowest, highest))
    return _assemble(time_s, values, np.sort(best), rounding)


Bounds = tuple[float | Array, float | Array]


def best_fit(
    residual: Callable[[Array], Array], jacobian: Callable[[Array], Array], starts: Sequence[Array], bounds: Bounds
) -> Array:
    """Minimise a sum of squares of few parameters from several starts; return the place of the lowest minimum.

    Parameters
    ----------
    residual, jacobian : (k,) → (n,) and (n, k).
    starts : (k,) each, within the bounds.
    bounds : lowest and highest values, of all parameters or (k,) of each.
    """
    places = [_search(residual, jacobian, start, bounds, _NEAR) for start in starts]
    best = min(places, key=lambda place: float(np.square(residual(place)).sum()))
    return _polish(residual, jacobian, _search(residual, jacobian, best, bounds, _GAIN), bounds)


def _search(
    residual: Callable[[Array], Array], jacobian: Callable[[Array], Array], place: Array, bounds: Bounds, least: float
) -> Array:
    """Levenberg–Marquardt with steps cut off at the bounds, damped as in Nielsen 1999 (IMM-REP-1999-05).

    Not scipy's ``least_squares``: a run has a hundred traces, and for one to three parameters it takes two to three
    times as long.
    """
    residuals, damping = residual(place), _DAMPING
    square = float(residuals @ residuals)
    for _ in range(_STEPS):
        slope = jacobian(place)
        downhill = -(slope.T @ residuals)
        # Parameters held by a bound do not take part.
        free = np.where(downhill > 0, place < bounds[1], place > bounds[0])
        normal, downhill = (slope.T @ slope) * free * free[:, None], downhill * free
        size = np.diag(np.where(free, normal.diagonal(), 1.0) + _TINY)
        gain, growth = 0.0, 2.0
        while not gain > 0:
            step = np.linalg.solve(normal + damping * size, downhill)
            expected = float(step @ (downhill + damping * (size @ step)))
            if not expected > least * square:
                return place
            aim = np.clip(place + step, *bounds)
            aim_residuals = residual(aim)
            gain = square - float(aim_residuals @ aim_residuals)
            if gain > 0:
                damping *= max(1 / 3, 1 - (2 * gain / expected - 1) ** 3)
            else:
                damping, growth = damping * growth, 2 * growth
        place, residuals, square = aim, aim_residuals, square - gain
    return place


def _polish(
    residual: Callable[[Array], Array], jacobian: Callable[[Array], Array], place: Array, bounds: Bounds
) -> Array:
    """Continue from the end of a search by plain Gauss–Newton steps while they gain."""
    residuals = residual(place)
    for _ in range(_POLISHING):
        step = np.linalg.lstsq(jacobian(place), -residuals, rcond=None)[0]
        aim = np.clip(place + step, *bounds)
        aim_residuals = residual(aim)
        if not aim_residuals @ aim_residuals < residuals @ residuals:
            break
        place, residuals = aim, aim_residuals
    return place


def chance_of_gain(before: Array, after: Array, parameters: int, added: int) -> float:
    """Probability that chance gains as much as some more parameters: an F test over the independent points only.

    Parameters
    ----------
    before, after : (n,) residuals without and with them.
    parameters : total with them, including offsets.
    added : number added.
    """
    tiny = float(np.finfo(np.float64).tiny)
    centred = after - after.mean()
    lag = float(centred[1:] @ centred[:-1] / max(float(centred @ centred), tiny))
    memory = min(max(lag, 0.0), 0.99)
    # At least one degree: a fit that removes all but a ten-thousandth of the rest is accepted even if its residual is
    # smooth, as without noise but that of the search.
    freedom = max(len(centred) * (1 - memory) / (1 + memory) - parameters, 1.0)
    square = float(after @ after)
    gain = (float(before @ before) - square) / added
    return float(fdtrc(added, freedom, max(gain, 0.0) * freedom / max(square, tiny)))


def _basis(time_s: Array, log_tau: Array) -> Array:
    return np.exp(-time_s[:, None] / np.exp(log_tau)[None, :])


def _subtract_means(columns: Array) -> Array:
    centred: Array = columns - np.add.reduce(columns) / len(columns)
    return centred


def _slopes(time_s: Array, basis: Array, log_tau: Array) -> Array:
    """Derivatives of the exponentials with respect to log τ."""
    return basis * (time_s[:, None] / np.exp(log_tau))


def _back_substitute(r: Array, right: Array) -> Array:
    """Solve R x = b without columns that the earlier ones already span (τ₁ = τ₂)."""
    diagonal = np.abs(r.diagonal())
    solution = np.zeros(len(diagonal))
    for row in np.flatnonzero(diagonal > 1e-12 * diagonal.max(initial=0.0))[::-1]:
        solution[row] = (right[row] - r[row] @ solution) / r[row, row]
    return solution


def _starts(time_s: Array, values: Array, count: int, bounds: tuple[float, float]) -> list[Array]:
    grid = np.linspace(*bounds, _GRID + 2)[1:-1]
    basis = _subtract_means(_basis(time_s, grid))
    basis = basis / np.maximum(np.linalg.norm(basis, axis=0), np.finfo(float).tiny)
    projections = basis.T @ values
    if count == 1:
        return [grid[[index]] for index in np.argsort(-(projections**2))[:_STARTS]]
    # Second columns made orthogonal to the first, so that their explained sums add.
    overlap = basis.T @ basis
    orthogonal_share = np.maximum(1 - overlap**2, 1e-9)
    gain = projections[:, None] ** 2 + (projections[None, :] - overlap * projections[:, None]) ** 2 / orthogonal_share
    gain[np.tril_indices(_GRID)] = -np.inf
    best = np.argsort(-gain, axis=None)[: _STARTS * 8 : 8]
    return [grid[list(np.unravel_index(int(index), gain.shape))] for index in best]


def _assemble(time_s: Array, values: Array, log_tau: Array, rounding: float) -> Exponentials:
    basis = _basis(time_s, log_tau)
    q, r = np.linalg.qr(_subtract_means(basis))
    amplitudes = _back_substitute(r, q.T @ (values - values.mean()))
    offset = values.mean() - float(basis.mean(axis=0) @ amplitudes)
    residual = (values - values.mean()) - (basis - basis.mean(axis=0)) @ amplitudes
    design = np.column_stack([np.ones_like(time_s), basis, _slopes(time_s, basis, log_tau) * amplitudes])
    spare = max(len(values) - design.shape[1], 1)
    noise = max(float(np.sqrt(residual @ residual / spare)), rounding)
    return Exponentials(np.exp(log_tau), np.concatenate([[offset], amplitudes]), residual, noise * _spread(design))


def _spread(design: Array) -> Array:
    """Standard errors per unit noise, √diag (XᵀX)⁻¹ by QR of the scaled design; infinite where it is singular."""
    size = np.linalg.norm(design, axis=0)
    if (size == 0).any():
        return np.full(design.shape[1], np.inf)
    r = np.linalg.qr(design / size, mode="r")
    diagonal = np.abs(np.diag(r))
    if diagonal.min() <= 1e-13 * diagonal.max():
        return np.full(design.shape[1], np.inf)
    inverse = solve_triangular(r, np.eye(len(r)))
    spread: Array = np.linalg.norm(inverse, axis=1) / size
    return spread
