"""Criteria that choose λ from readings alone: generalised cross-validation, L-curve, discrepancy.

All of them need the residual, the size of the image and the degrees of freedom as functions of λ, and these are sums
over the dual spectrum: with eigenvalues Λ of W^½JPJᵀW^½ and z the readings' coefficients,

    ‖W^½(y − Jx)‖² = Σ (λ²/(Λ + λ²))² z²,   xᵀRx = Σ Λ/(Λ + λ²)² z²,   trace(I − H) = Σ λ²/(Λ + λ²)

over the part of the readings that is regularised at all. Several frames share one λ: their z² add up.
"""

from collections.abc import Callable
from typing import Final

import numpy as np
from scipy.optimize import brentq, minimize_scalar

from cbsr_qa.domain import Array, NumericsError

_LOWEST: Final = 1e-6  #: λ searched, relative to the root of the largest eigenvalue
_HIGHEST: Final = 1e3
_STEPS: Final = 361  #: logarithmic; 40 a decade


class RidgeCurves:
    """Residual, size and degrees of freedom over s = ln λ².

    Parameters
    ----------
    values : (k,) eigenvalues Λ, not negative.
    coefficients : (n, k) of n frames of readings, in units of their noise up to a common factor.

    Raises
    ------
    NumericsError
        If a coefficient is not finite, or all are zero.
    """

    def __init__(self, values: Array, coefficients: Array) -> None:
        energy = (coefficients**2).sum(axis=0)
        if not np.isfinite(energy).all():
            raise NumericsError("a reading to choose λ from is not a finite number", remedy="leave its channel out")
        if not energy.any():
            raise NumericsError(
                "the readings to choose λ from do not differ from their reference: nothing to fit",
                remedy="choose by noise figure, or on readings of a load",
            )
        self._values, self._energy = values, energy
        largest = float(np.sqrt(values.max()))
        self.grid: Array = 2 * np.linspace(np.log(_LOWEST * largest), np.log(_HIGHEST * largest), _STEPS)

    def residual(self, s: Array | float) -> Array:
        """Weighted squared residual of all frames."""
        gone = self._gone(s)
        return np.asarray(gone**2 @ self._energy)

    def size(self, s: Array | float) -> Array:
        """xᵀRx of all frames."""
        ridge = np.exp(np.asarray(s))[..., None]
        return np.asarray((self._values / (self._values + ridge) ** 2) @ self._energy)

    def freedom(self, s: Array | float) -> Array:
        """Degrees of freedom of one frame's residual."""
        return np.asarray(self._gone(s).sum(axis=-1))

    def cross_validation(self, s: Array | float) -> Array:
        """GCV function (Golub, Heath & Wahba 1979), residual over squared degrees of freedom."""
        return self.residual(s) / self.freedom(s) ** 2

    def curvature(self, s: Array | float) -> Array:
        """Curvature of ln‖x‖ over ln‖residual‖, positive at a corner towards the origin (Hansen 1992).

        With t = λ², η = xᵀRx, ρ = residual and S_j = ΣΛz²/(Λ + t)^j: dη/dt = −2S₃, dρ/dt = 2tS₃.
        """
        ridge = np.exp(np.asarray(s))
        total = self._values + ridge[..., None]
        third, fourth = (self._values / total**power @ self._energy for power in (3, 4))
        size, residual = self.size(s), self.residual(s)
        # Derivatives along s of η and ρ, then of half their logarithms.
        eta, rho = -2 * ridge * third, 2 * ridge**2 * third
        eta2 = eta + 6 * ridge**2 * fourth
        rho2 = 2 * rho - 6 * ridge**3 * fourth
        x1, y1 = rho / residual / 2, eta / size / 2
        x2, y2 = rho2 / residual / 2 - 2 * x1**2, eta2 / size / 2 - 2 * y1**2
        curvature: Array = (x1 * y2 - x2 * y1) / (x1**2 + y1**2) ** 1.5
        return curvature

    def _gone(self, s: Array | float) -> Array:
        ridge = np.exp(np.asarray(s))[..., None]
        return np.asarray(ridge / (self._values + ridge))


def by_cross_validation(curves: RidgeCurves) -> float:
    """λ of the lowest GCV function.

    Raises
    ------
    NumericsError
        If it has no minimum in the range searched: the readings are all signal, or all noise.
    """
    where = int(np.argmin(curves.cross_validation(curves.grid)))
    return _refined(
        curves, where, lambda s: float(np.log(curves.cross_validation(s))), "generalised cross-validation"
    )


def by_l_curve(curves: RidgeCurves) -> float:
    """λ of the sharpest corner of the L-curve.

    Raises
    ------
    NumericsError
        If the curve has no corner in the range searched.
    """
    bend = curves.curvature(curves.grid)
    # At both ends one of the two logarithms stands still and the quotient is one of roundings.
    steep = np.abs(np.gradient(np.log(curves.residual(curves.grid)), curves.grid)) > _STILL
    bend = np.where(steep & np.isfinite(bend), bend, -np.inf)
    where = int(np.argmax(bend))
    if not bend[where] > 0:
        raise NumericsError(f"the L-curve has no corner {_range(curves)}", remedy=_REMEDY)
    return _refined(curves, where, lambda s: -float(curves.curvature(s)), "the L-curve")


def by_discrepancy(curves: RidgeCurves, level: float) -> float:
    """λ at which the residual is as large as the noise (Morozov 1966).

    Parameters
    ----------
    level : expected weighted squared residual of all frames together, number of readings times noise variance.

    Raises
    ------
    NumericsError
        If no λ in the range searched leaves so much: the readings are noise alone, or have none.
    """
    low, high = (float(curves.residual(end)) for end in (curves.grid[0], curves.grid[-1]))
    if not low < level < high:
        what = "the readings do not exceed their noise" if level >= high else "there is almost no noise"
        raise NumericsError(
            f"the discrepancy principle has no answer {_range(curves)}: {what} (residual {np.sqrt(low):.3g} to"
            f" {np.sqrt(high):.3g}, noise {np.sqrt(max(level, 0.0)):.3g})",
            remedy=_REMEDY,
        )
    root = brentq(lambda s: float(np.log(curves.residual(s) / level)), curves.grid[0], curves.grid[-1], xtol=1e-12)
    return rounded(float(np.exp(root / 2)))


def rounded(value: float) -> float:
    """Ten digits: those beyond depend on how many threads the linear algebra has."""
    return float(f"{value:.10g}")


_STILL: Final = 1e-6
_REMEDY: Final = "choose by noise figure, or give the hyperparameter itself"


def _refined(curves: RidgeCurves, where: int, cost: Callable[[float], float], criterion: str) -> float:
    """Polish a minimum found on the grid."""
    if where in (0, len(curves.grid) - 1):
        raise NumericsError(f"{criterion} has no minimum {_range(curves)}", remedy=_REMEDY)
    bounds = (float(curves.grid[where - 1]), float(curves.grid[where + 1]))
    best = minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": 1e-9})
    return rounded(float(np.exp(best.x / 2)))


def _range(curves: RidgeCurves) -> str:
    low, high = np.exp(curves.grid[[0, -1]] / 2)
    return f"for λ from {low:.2g} to {high:.2g}"
