"""Images of linear problems in fifty digits, on sensors of any size: truth for what squares condition numbers.

The dual system of the usual sensor has 104 readings and 2025 elements; twenty million products are too many for
mpmath. Products of matrices are therefore split into slices of 21 bits, whose products and sums are exact in doubles
(Ozaki et al. 2012), and only the small system is solved in fifty digits.
"""

from typing import Any, Final

import numpy as np
from mpmath import mp
from numpy.typing import NDArray

Array = NDArray[np.float64]
#: In extended precision, 64 bits of mantissa.
Long = NDArray[np.longdouble]

_DIGITS: Final = 50
_BITS: Final = 21
_SLICES: Final = 5  # 105 bits below the largest entry of a row
_SUMMED: Final = 2048  # products of 42 bits each add up within 53 bits


def exact_image(jacobian: Array, weights: Array, hyperparameter: float, variance: Array, readings: Array) -> Array:
    """Image (JᵀWJ + λ²R)⁻¹ JᵀWy with diagonal R, by its dual form in fifty digits.

    Parameters
    ----------
    jacobian : (m, e). weights : (e,) diagonal of R. variance : (m,) diagonal of W⁻¹. readings : (m,) y.

    Returns
    -------
    (e,) float64, right to some 1e-19 times κ, the condition number of W^½JR^−½ with λ among its singular values.
    """
    root = np.sqrt(weights.astype(np.longdouble))
    scaled = jacobian.astype(np.longdouble) / root
    with mp.workdps(_DIGITS):
        system = exact_gram(scaled)
        for row, own in enumerate(variance.tolist()):
            system[row][row] += mp.mpf(hyperparameter) ** 2 * mp.mpf(own)
        coefficients = _solved(system, [mp.mpf(float(value)) for value in readings])
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


def _solved(lower: list[list[Any]], right: list[Any]) -> list[Any]:
    """Solve a symmetric system of which the lower triangle is given, by Cholesky factors."""
    count = len(lower)
    for j in range(count):
        own = lower[j]
        own[j] = mp.sqrt(own[j] - mp.fdot(own[:j], own[:j]))
        for i in range(j + 1, count):
            lower[i][j] = (lower[i][j] - mp.fdot(lower[i][:j], own[:j])) / own[j]
    found = list(right)
    for i in range(count):
        found[i] = (found[i] - mp.fdot(lower[i][:i], found[:i])) / lower[i][i]
    for i in reversed(range(count)):
        above = [lower[k][i] for k in range(i + 1, count)]
        found[i] = (found[i] - mp.fdot(above, found[i + 1 :])) / lower[i][i]
    return found


def _in_parts(value: Any) -> tuple[float, float, float]:
    high = float(value)
    middle = float(value - high)
    return high, middle, float(value - high - middle)
