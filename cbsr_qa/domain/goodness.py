"""How much of a signal a model explains, and whether what it leaves is more than noise and a stated allowance."""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from cbsr_qa.domain.numbers import Array, Mask

#: Energy that a model may leave in addition to noise, over the energy that it explains. Weak loads of one size, on a
#: lattice of 8 % of the radius, leave up to 3 % (99 % of loads) of heads of 4 to 27 % of the radius and contrasts of
#: −50 to 200 %; unknown noise of a tenth of the median change leaves another 3 %. The rest is for
#: electrodes, contacts and gains that are off by a tenth or two, which leaves the square of that.
ALLOWANCE: Final = 0.1
#: Least share of the signal that a model has to explain, from the same allowance.
LEAST_EXPLAINED: Final = 1 / (1 + ALLOWANCE)
#: Number of standard deviations of χ² that noise may leave.
_ROOM: Final = 4.0


@dataclass(frozen=True, slots=True)
class Goodness:
    """Goodness of fit of one change of readings.

    Parameters
    ----------
    explained : share of the readings' squares over the variance of their noise that the model explains, those of
        noise taken off.
    explained_unweighted : the same of the readings' squares.
    in_model : whether the model leaves no more than noise and :data:`ALLOWANCE`.
    """

    explained: float
    explained_unweighted: float
    in_model: bool

    @classmethod
    def from_fit(cls, change: Array, fitted: Array, sigma: Array, variance: float) -> Self:
        """Judge a least-squares fit (m,) of a change (m,), both over the noise ``sigma`` (m,) of a frame.

        Parameters
        ----------
        variance : variance of the noise of the change, in units of a frame's.
        """
        residual, energy = (change - fitted) ** 2, change**2
        weighted, unweighted = (
            float(share_explained((energy - residual) @ weight, residual @ weight, variance * weight.sum()))
            for weight in (np.ones_like(sigma), sigma**2)
        )
        unlike = deviates_from_model((energy - residual).sum() / variance, residual.sum() / variance, len(change))
        return cls(weighted, unweighted, in_model=not unlike)


def share_explained(gain: Array, left: Array, noise: float) -> Array:
    """Share of the signal that a model explains, noise taken off.

    Parameters
    ----------
    gain, left : squares that the model explains and leaves.
    noise : squares that noise is expected to leave; 0 if unknown.
    """
    signal = np.maximum(gain, np.finfo(np.float64).tiny)
    share: Array = signal / (signal + np.maximum(left - noise, 0.0))
    return share


def deviates_from_model(gain: Array, left: Array, freedom: float, allowance: float = ALLOWANCE) -> Mask:
    """Whether a model leaves more than noise and an allowance account for.

    Parameters
    ----------
    gain, left : squares of unit noise that the model explains and leaves.
    freedom : residuals less unknowns.
    """
    unlike: Mask = left - freedom - _ROOM * np.sqrt(2 * freedom) > allowance * gain
    return unlike
