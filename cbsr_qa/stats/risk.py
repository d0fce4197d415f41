"""Consumer's and producer's risk of a limit judged with an uncertain measurement (JCGM 106:2012, clause 9).

The true value η of a sensor has a density g (the lot's), the measured one is normal about it with standard deviation
u. Behind an upper limit T with acceptance limit A = T − w,

    consumer's risk = ∫_{η > T} P(measured ≤ A | η) g(η) dη     a bad sensor is accepted
    producer's risk = ∫_{η ≤ T} P(measured > A | η) g(η) dη     a good sensor is rejected

Both are global risks: shares of all sensors of the population that the lot was drawn from.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import special

from cbsr_qa.domain.numbers import Array

#: Density of true values: (n,) values → (n,) densities.
Density = Callable[[Array], Array]

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(400)
_REACH = 8.0  #: standard uncertainties beyond which a measurement misleads nobody


@dataclass(frozen=True, slots=True)
class Risks:
    """Shares of all sensors, between 0 and 1."""

    consumer: float
    producer: float

    def __add__(self, other: "Risks") -> "Risks":
        """Add the risks of the other bound; a sensor that risks both counts twice, so this is a cautious sum."""
        return Risks(self.consumer + other.consumer, self.producer + other.producer)


def risks_of_bound(density: Density, limit: float, guard: float, uncertainty: float) -> Risks:
    """Return the risks of an upper limit; for a lower one give the mirrored density and limit.

    Parameters
    ----------
    density : of the true values.
    limit : T, in the density's unit.
    guard : w ≥ 0, width of the guard band inside the limit.
    uncertainty : u > 0, standard uncertainty of a measurement.
    """
    accepted_to = limit - guard

    def accepted(true: Array) -> Array:
        share: Array = special.ndtr((accepted_to - true) / uncertainty)
        return share

    bad, bad_weights = _panel(limit, limit + _REACH * uncertainty)
    good, good_weights = _panel(accepted_to - _REACH * uncertainty, limit)
    consumer = float(np.sum(bad_weights * accepted(bad) * density(bad)))
    producer = float(np.sum(good_weights * (1 - accepted(good)) * density(good)))
    return Risks(consumer, producer)


def _panel(low: float, high: float) -> tuple[Array, Array]:
    half = 0.5 * (high - low)
    return low + half * (_NODES + 1), half * _WEIGHTS
