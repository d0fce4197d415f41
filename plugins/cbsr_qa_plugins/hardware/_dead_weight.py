"""A load cell against a known mass."""

from dataclasses import dataclass
from typing import Final

from cbsr_qa.domain.errors import RefusedError

#: Newtons of one gram force: standard gravity (CGPM 1901); places on earth differ by half a percent at most.
NEWTON_PER_G: Final = 9.80665e-3


@dataclass(frozen=True, slots=True)
class DeadWeightCheck:
    """What a load cell said under a known mass.

    Parameters
    ----------
    mass_g : of the weight.
    found_N, error_N : mean of the readings and its standard error.
    expected_N : the mass's weight at standard gravity.
    tolerance_N : how far they may be apart.
    """

    mass_g: float
    found_N: float
    error_N: float
    expected_N: float
    tolerance_N: float

    @property
    def passed(self) -> bool:
        """Whether found and expected are as near as they should be."""
        return abs(self.found_N - self.expected_N) <= self.tolerance_N

    def words(self) -> str:
        """Say what was found and what was expected."""
        return (
            f"{self.found_N:.4g} N ± {self.error_N:.1g} N under {self.mass_g:g} g;"
            f" {self.expected_N:.4g} N ± {self.tolerance_N:.2g} N expected"
        )


def dead_weight_check(found_N: float, error_N: float, mass_g: float, tolerance_percent: float) -> DeadWeightCheck:
    """Hold a mean force against the weight of a mass.

    Raises
    ------
    RefusedError
        If the mass or the tolerance is not above 0.
    """
    if not (mass_g > 0 and tolerance_percent > 0):
        raise RefusedError(
            f"a dead weight of {mass_g:g} g to within {tolerance_percent:g} % checks nothing",
            remedy="mass and tolerance are above 0",
        )
    expected_N = NEWTON_PER_G * mass_g
    return DeadWeightCheck(mass_g, found_N, error_N, expected_N, tolerance_percent / 100 * expected_N)
