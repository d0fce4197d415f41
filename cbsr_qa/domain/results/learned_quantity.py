"""How hard a sheet is pressed, as learned from labelled presses: what a calibration file keeps of force or depth."""

from dataclasses import dataclass
from typing import Annotated

from cbsr_qa.domain.kept import OWN, Kept
from cbsr_qa.domain.numbers import Array

_LARGEST = 1e12
_NotNegative = Annotated[float, Kept(least=0, most=_LARGEST)]


@dataclass(frozen=True, slots=True)
class QuantityScales:
    """Hyperparameters of a :class:`LearnedQuantity`: variances, in units of the spread of what was pressed.

    Parameters
    ----------
    ring : variance of what depends on the distance from the centre alone.
    relief : variance of what depends on the place.
    curve : variance of what depends on the strength, beside a straight line.
    noise : variance of the noise of a press.
    weak_noise : additional noise variance of a press of median strength; it falls with the square of the strength.
    length_mm : length over which ring and relief change.
    """

    ring: _NotNegative
    relief: _NotNegative
    curve: _NotNegative
    noise: _NotNegative
    weak_noise: _NotNegative
    length_mm: _NotNegative


@dataclass(frozen=True, slots=True, eq=False)
class LearnedQuantity:
    """A quantity of a press from its strength and place: a Gaussian process given presses.

    Parameters
    ----------
    logarithmic : whether the process is of the quantity's logarithm: all presses were positive.
    centre_mm : (2,) centre of the sheet in the frame of the presses.
    strength : (n,) strengths of the presses: their changes over the templates at their places.
    places_mm : (n, 2) as found when each press was left out.
    values : (n,) values of the presses.
    quantiles : (2,) errors of presses left out, in stated standard errors, that hold 68 and 95 % of them.
    error, error_stderr : mean absolute error of presses left out, and its standard error.
    covered : (2,) share of the presses left out that the intervals of 68 and 95 % hold, as wide as the other half of
        them says.
    drift, weak_drift : standard deviations of what drift may add later, in the spread of the values: to all, and
        beside it to a press of median strength; that falls with the strength.
    """

    logarithmic: bool
    scales: QuantityScales
    centre_mm: Annotated[Array, Kept(dims="2", most=_LARGEST)]
    strength: Annotated[Array, Kept(dims="presses", least=0, most=_LARGEST)]
    places_mm: Annotated[Array, Kept(dims="presses 2", most=_LARGEST)]
    values: Annotated[Array, Kept(units=OWN, dims="presses", most=_LARGEST)]
    quantiles: Annotated[Array, Kept(dims="2", least=0, most=_LARGEST)]
    error: Annotated[float, Kept(units=OWN, least=0, most=_LARGEST)]
    error_stderr: Annotated[float, Kept(units=OWN, least=0, most=_LARGEST)]
    covered: Annotated[Array, Kept(dims="2", least=0, most=1)]
    drift: Annotated[float, Kept(least=0, most=_LARGEST)] = 0.0
    weak_drift: Annotated[float, Kept(least=0, most=_LARGEST)] = 0.0
