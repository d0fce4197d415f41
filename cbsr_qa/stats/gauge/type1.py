"""Type 1 gauge study: one reference of known value, measured again and again by one appraiser.

With a tolerance T, a share K = 20 % of it and L = 6 standard deviations (VDA 5; the defaults of common software),

    Cg = (K T/100)/(L s),    Cgk = (K T/200 − |x̄ − r|)/(L s/2)

These are Pp and Ppk of the readings for limits r ± K T/200, and so are their intervals
(:mod:`cbsr_qa.stats.process_capability`). An error of r moves all readings alike: the ends of Cgk are the least and
the greatest over r ± z u.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Final

from scipy.special import ndtri

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.stats.gauge.crossed_study import check_tolerance
from cbsr_qa.stats.process_capability import Index, capability
from cbsr_qa.stats.samples import constant, sample

#: Least number of readings; 25 to 50 are usual.
FEWEST: Final = 10
#: K as a fraction.
SHARE_OF_TOLERANCE: Final = 0.2
#: Value from which a gauge is usually called capable.
CAPABLE: Final = 1.33


@dataclass(frozen=True, slots=True)
class Type1Study:
    """A gauge at one reference.

    Parameters
    ----------
    cg : index of repeatability alone.
    cgk : of repeatability and bias.
    """

    cg: Index
    cgk: Index

    def capable(self) -> bool | None:
        """Whether both indices are shown to reach :data:`CAPABLE`; False if one does not, None if it is not shown."""
        if min(self.cg.value, self.cgk.value) < CAPABLE:
            return False
        return True if min(self.cg.low, self.cgk.low) >= CAPABLE else None


def study_type1(
    readings: Iterable[float],
    reference: float,
    tolerance: float,
    *,
    uncertainty: float = 0.0,
    confidence: float = 0.95,
) -> Type1Study:
    """Return Cg and Cgk of readings of one reference.

    Parameters
    ----------
    readings : (n,) readings, n at least :data:`FEWEST`.
    reference, uncertainty : true value and its standard deviation, in the unit of the readings.
    tolerance : width of the metric's limits.

    Raises
    ------
    NumericsError
        Too few, missing or equal readings, or a tolerance that is not positive.
    """
    check_tolerance(tolerance)
    values = sample(readings, "type 1 study", least=FEWEST)
    if constant(values):
        raise NumericsError(
            f"type 1 study: all {len(values)} readings are {values[0]:.6g}, so there is no scatter to state",
            remedy="record readings with more digits",
        )
    half_width = SHARE_OF_TOLERANCE * tolerance / 2
    if not uncertainty >= 0:
        raise NumericsError(
            f"type 1 study: the reference's uncertainty is {uncertainty:g}; allowed are values from 0"
        )

    def index_about(centre: float) -> tuple[Index, Index]:
        indices = capability(
            [values], lower=centre - half_width, upper=centre + half_width, confidence=confidence, what="type 1 study"
        )
        assert indices.pp is not None  # both limits are given
        return indices.pp, indices.ppk

    reach = float(ndtri((1 + confidence) / 2)) * uncertainty
    cg, cgk = index_about(reference)
    moved = [index_about(reference + shift)[1] for shift in (-reach, 0.0, reach)]
    inside = abs(float(values.mean()) - reference) <= reach
    highest = index_about(float(values.mean()))[1].high if inside else max(index.high for index in moved)
    return Type1Study(cg, replace(cgk, low=min(index.low for index in moved), high=highest))
