"""The model of a batch: how alike its sensors are, and what that says about the next one."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.interpolate import PchipInterpolator

from cbsr_qa.calibration.batch.likelihood import BatchLikelihood, Hyperparameters
from cbsr_qa.calibration.batch.loads import BatchLoads, SensorLoads
from cbsr_qa.calibration.batch.posterior import Posterior, find_posterior, slope_of_share
from cbsr_qa.calibration.batch.prior import BatchPrior
from cbsr_qa.domain.numbers import Array

#: Number of members that a prior is made of.
_MEMBERS: Final = 100
#: Number of places at which the density of ζ is integrated, and the probability of the interval.
_FINE: Final = 4001
_PROBABILITY: Final = 0.95
#: Density over the largest one where the lattice has none.
_NO_DENSITY: Final = 1e-9
#: ρ from which on sensors cannot be told from identical ones.
_IDENTICAL: Final = 0.9995


@dataclass(frozen=True, slots=True)
class Share:
    """A share with its interval of 95 %.

    Parameters
    ----------
    value : median of the posterior, or the end of the interval that it is beyond.
    mean : its mean.
    """

    value: float
    low: float
    high: float
    mean: float


@dataclass(frozen=True, slots=True, eq=False)
class BatchModel:
    """Model of a batch.

    Parameters
    ----------
    loads : loads of all sensors.
    radius_mm : radius of the sheet.
    posterior : of the hyperparameters.
    choices, weights : members that the prior of a further sensor is made of.
    """

    loads: BatchLoads
    radius_mm: float
    posterior: Posterior
    choices: tuple[Hyperparameters, ...]
    weights: tuple[float, ...]
    rho: Share
    prior: BatchPrior


def learn_batch(sensors: Sequence[SensorLoads], *, radius_mm: float, members: int = _MEMBERS) -> BatchModel:
    """Learn the model of a batch from the loads of its sensors.

    Parameters
    ----------
    radius_mm : radius of the sheet, the unit of the correlation lengths.
    members : largest number of members of the prior.
    """
    loads = BatchLoads(sensors)
    likelihood = BatchLikelihood(loads)
    posterior = find_posterior(likelihood, radius_mm)
    choices, weights = thin(posterior, members)
    prior = BatchPrior(likelihood, choices, weights)
    return BatchModel(loads, radius_mm, posterior, choices, weights, estimate_share(posterior), prior)


def thin(posterior: Posterior, members: int) -> tuple[tuple[Hyperparameters, ...], tuple[float, ...]]:
    """Draw members in proportion to their weights, evenly along the lattice (systematic resampling)."""
    steps = (np.arange(members) + 0.5) / members
    drawn, counts = np.unique(np.searchsorted(np.cumsum(posterior.weights), steps), return_counts=True)
    drawn = np.minimum(drawn, len(posterior.choices) - 1)
    return tuple(posterior.choices[number] for number in drawn), tuple((counts / members).tolist())


def estimate_share(posterior: Posterior) -> Share:
    """Median and mean of ρ, and its interval.

    The interval is taken with Jeffreys' prior, and has equal tails. If the shortest interval begins at zero, that one
    is taken. ``benchmarks/batch_rho.py`` measures how often it holds ρ.
    """
    matched = posterior.weights / np.sqrt(slope_of_share(posterior.share, posterior.sensors))
    shares, mass = _spread_mass(posterior, posterior.weights)
    ratio = np.expm1(shares) / posterior.sensors
    rho = ratio / (1 + ratio)
    median = rho[np.searchsorted(np.cumsum(mass), 0.5)]
    _, matched_mass = _spread_mass(posterior, matched / matched.sum())
    order = np.argsort(-matched_mass, kind="stable")
    shortest = order[: int(np.searchsorted(np.cumsum(matched_mass[order]), _PROBABILITY)) + 1]
    tail = (1 - _PROBABILITY) / 2
    ends = np.searchsorted(np.cumsum(matched_mass), [tail, 1 - tail])
    first, last = (0, shortest.max()) if shortest.min() == 0 else ends
    low, high = float(rho[first]), float(rho[last])
    high = 1.0 if high > _IDENTICAL else high
    return Share(float(np.clip(median, low, high)), low, high, float(mass @ rho))


def _spread_mass(posterior: Posterior, weights: Array) -> tuple[Array, Array]:
    """Finely spaced ζ, and the weights spread over them: the logarithm of the density is interpolated."""
    step, last = posterior.share_step, round(float(posterior.share.max()) / posterior.share_step)
    nodes = np.arange(last + 2) * step
    mass = np.bincount(np.round(posterior.share / step).astype(np.intp), weights, minlength=last + 2)
    density = mass / np.where(nodes == 0, step / 2, step)
    fine = np.linspace(0.0, nodes[-1], _FINE)
    log_density = PchipInterpolator(nodes, np.log(np.maximum(density, density.max() * _NO_DENSITY)))(fine)
    spread: Array = np.exp(log_density - log_density.max())
    return fine, spread / spread.sum()
