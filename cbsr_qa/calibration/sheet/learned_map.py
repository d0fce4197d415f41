"""What is asked of a learned map of the response, by forces and by the decision where to press next."""

from typing import Protocol

from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.results.calibration import BatchUse


class LearnedMap(Protocol):
    """A map as a mixture of m members: Gaussian processes of the logarithm of the response."""

    @property
    def batch(self) -> BatchUse | None:
        """What it owes to the sensor's batch; None without such a prior."""
        ...

    @property
    def bend(self) -> tuple[float, float]:
        """Multiple of the effect of a wrong intercept of the line, and its variance; zeros without one."""
        ...

    def predict(self, places_mm: Array) -> tuple[Array, Array]:
        """Mean and variance (n,) of the logarithm of the response at places (n, 2), without the scatter of loads."""
        ...

    @property
    def weights(self) -> Array:
        """Posterior weights (m,) of the members, with sum one."""
        ...

    @property
    def scatter(self) -> float:
        """Relative scatter of single loads."""
        ...

    def predict_members(self, places_mm: Array) -> tuple[Array, Array]:
        """Means and variances (m, n) of each member at places (n, 2)."""
        ...

    def covariance(self, places_mm: Array, others_mm: Array) -> Array:
        """Posterior covariance (m, n, t) of each member, of places (n, 2) with others (t, 2)."""
        ...

    def variance_after(self, candidates_mm: Array, targets_mm: Array, variance: float) -> Array:
        """Variance (m, n, t) at targets (t, 2) after one more load at each candidate (n, 2), with this variance."""
        ...
