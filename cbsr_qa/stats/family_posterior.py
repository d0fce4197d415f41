"""What a sample says of location and scale of a family: its evidence, and how far out a quantile may lie.

With the prior dμ dσ/σ (the right-invariant one), the posterior of a quantile μ + σ z gives bounds with exactly the
stated confidence if the family is the right one; for a normal sample they are those of the noncentral t. The
evidence ∫∫ Π f((x − μ)/σ)/σ dμ dσ/σ of two families tells them apart as well as any test that does not depend on unit
and origin (Lehmann & Romano 2005, section 6.3; Berger, Pericchi & Varshavsky 1998).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import optimize

from cbsr_qa.domain.numbers import Array
from cbsr_qa.stats.families import Family

_STEP: Final = 1e-3  #: of differences, in scales
_NODES: Final = 41  #: along each axis; more than one a standard deviation of the posterior
_REACH: Final = 9.0  #: standard deviations of the location, scale given
_SCALE_REACH: Final = (10.0, 12.0)  #: of log σ: this over √n, and over n − 1 further above
_FARTHEST_LOG: Final = 20.0  #: below the median absolute deviation, where the most likely scale is sought
_LEAST_CURVATURE: Final = 0.05  #: a value's share of information; less is a saddle


@dataclass(frozen=True, eq=False)
class Posterior:
    """Posterior of a family's location and scale.

    Parameters
    ----------
    family : the family.
    location, scale : the most likely ones.
    log_evidence : logarithm of the evidence.
    scales, scale_weights : nodes of σ, (S,), and their posterior weights, which sum to 1.
    first_offset, offset_step : first node of (μ − location)/σ at each σ, (S,), and the step between nodes.
    below : posterior share below each node of the offset, (S, U).
    """

    family: Family
    location: float
    scale: float
    log_evidence: float
    scales: Array
    scale_weights: Array
    first_offset: Array
    offset_step: float
    below: Array

    def exceedance(self, limit: float, share: float) -> float:
        """Return the probability that the quantile of this share lies above a limit."""
        offset = (limit - self.location) / self.scales - self.family.quantile(share)
        place = np.clip((offset - self.first_offset) / self.offset_step, 0.0, _NODES - 1.000001)
        node = place.astype(int)
        rows = np.arange(len(node))
        low, high = self.below[rows, node], self.below[rows, node + 1]
        return float(np.sum(self.scale_weights * (1 - low - (high - low) * (place - node))))

    def nodes(self) -> tuple[Array, Array, Array]:
        """Return locations, scales and weights of the grid, (S (U − 1),) each; the weights sum to 1."""
        steps = self.offset_step * (np.arange(_NODES - 1) + 0.5)
        scales = np.repeat(self.scales, _NODES - 1)
        locations = self.location + scales * (self.first_offset[:, None] + steps).ravel()
        weights = (self.scale_weights[:, None] * np.diff(self.below, axis=1)).ravel()
        return locations, scales, weights


def find_posterior(values: Array, family: Family) -> Posterior:
    """Integrate the likelihood of values (n,), of which more than half differ from their median, on a grid.

    The grid is centred on the most likely location and scale, and sheared by how the location depends on the scale.
    """
    count = len(values)
    middle = float(np.median(values))
    unit = 1.4826 * float(np.median(np.abs(values - middle)))
    standard = (values - middle) / unit

    def log_likelihood(location: float, log_scale: float) -> float:
        z = (standard - location) * np.exp(-log_scale)
        return float(np.sum(family.log_density(z))) - count * log_scale

    def loss(point: Array) -> tuple[float, Array]:
        here, log_unit = float(point[0]), float(point[1])
        step = _STEP * float(np.exp(log_unit))
        across = (log_likelihood(here + step, log_unit) - log_likelihood(here - step, log_unit)) / (2 * step)
        along = (log_likelihood(here, log_unit + _STEP) - log_likelihood(here, log_unit - _STEP)) / (2 * _STEP)
        return -log_likelihood(here, log_unit) / count, -np.array([across, along]) / count

    least, greatest = float(standard.min()), float(standard.max())
    bounds = [(least, greatest), (-_FARTHEST_LOG, float(np.log(greatest - least)) + 1)]
    best = optimize.minimize(loss, np.zeros(2), jac=True, method="L-BFGS-B", bounds=bounds).x
    location, log_scale = float(best[0]), float(best[1])
    information, shear = _curvature(log_likelihood, location, log_scale, count)
    reach = _REACH / np.sqrt(information)
    lower, upper = _SCALE_REACH[0] / np.sqrt(count), _SCALE_REACH[0] / np.sqrt(count) + _SCALE_REACH[1] / (count - 1)
    logs = np.linspace(-lower, upper, _NODES)
    steps = np.linspace(-reach, reach, _NODES)
    scales = np.exp(log_scale + logs)
    log_weights = np.empty((_NODES, _NODES))
    for row, (sigma, moved) in enumerate(zip(scales, shear * logs, strict=True)):
        z = ((standard - location) / sigma)[:, None] - (moved + steps)
        # dμ dσ/σ = σ du d log σ
        log_weights[row] = family.log_density(z).sum(axis=0) - (count - 1) * np.log(sigma)
    largest = float(log_weights.max())
    weights = np.exp(log_weights - largest)
    rows = weights.sum(axis=1)
    total = float(rows.sum())
    halves = 0.5 * (weights[:, 1:] + weights[:, :-1])
    below = np.concatenate([np.zeros((_NODES, 1)), np.cumsum(halves, axis=1)], axis=1)
    below /= np.where(below[:, -1:] > 0, below[:, -1:], 1.0)
    evidence = largest + float(np.log(total * (logs[1] - logs[0]) * (steps[1] - steps[0])))
    return Posterior(
        family,
        location=middle + unit * location,
        scale=unit * float(np.exp(log_scale)),
        log_evidence=evidence - (count - 1) * float(np.log(unit)),
        scales=unit * scales,
        scale_weights=rows / total,
        first_offset=shear * logs - reach,
        offset_step=float(steps[1] - steps[0]),
        below=below,
    )


def _curvature(
    log_likelihood: Callable[[float, float], float], location: float, log_scale: float, count: int
) -> tuple[float, float]:
    """Return the information on the location in scales, and how it moves with log σ, from differences at the peak."""
    unit = np.exp(log_scale)

    def shifted(across: int, along: int) -> float:
        return log_likelihood(location + across * _STEP * unit, log_scale + along * _STEP)

    second = (shifted(1, 0) + shifted(-1, 0) - 2 * shifted(0, 0)) / _STEP**2
    mixed = (shifted(1, 1) - shifted(1, -1) - shifted(-1, 1) + shifted(-1, -1)) / (4 * _STEP**2)
    information = max(-second, _LEAST_CURVATURE * count)
    return information, float(np.clip(mixed / information, -1.0, 1.0))
