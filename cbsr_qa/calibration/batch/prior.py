"""The batch as prior of one more sensor: what its map is before a press, and after some."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Final

import numpy as np
from scipy.special import logsumexp

from cbsr_qa.calibration.batch.families import ConditionedFamily, Family, condition_members, mix_members
from cbsr_qa.calibration.batch.likelihood import BatchLikelihood, Hyperparameters
from cbsr_qa.calibration.batch.loads import SensorLoads
from cbsr_qa.calibration.batch.sensor_map import BatchMap
from cbsr_qa.domain.numbers import Array

#: Least weight of members that are kept for a sensor.
_NEGLIGIBLE: Final = 1e-5
#: Number of draws of a test, and what they are seeded with.
DRAWS: Final = 999
_SEED: Final = 52


@dataclass(frozen=True, slots=True)
class Likeness:
    """Whether a sensor's loads are those of a sensor of the batch.

    Parameters
    ----------
    p_value : probability that a sensor of the batch has an evidence as low.
    log_evidence : logarithm of the Bayes factor of the batch over a sensor that shares only how its map varies.
    """

    p_value: float
    log_evidence: float


class BatchPrior:
    """Distribution of the map of a sensor of the batch that was not yet pressed.

    Parameters
    ----------
    likelihood : loads of the batch.
    choices, weights : (m,) hyperparameters and their weights, with sum one.
    """

    def __init__(
        self, likelihood: BatchLikelihood, choices: Sequence[Hyperparameters], weights: Sequence[float]
    ) -> None:
        self.places_mm = likelihood.loads.places_mm
        self._families = []
        members = sorted(zip(choices, weights, strict=True))
        for (smooth, length_mm), group in groupby(members, key=lambda member: member[0].kind[:2]):
            parts = []
            of_family = list(group)
            for _, same in groupby(of_family, key=lambda member: member[0].kind):
                parts.append(likelihood.compute_precision([choice for choice, _ in same]))
            precision, pull = (np.concatenate(columns) for columns in zip(*parts, strict=True))
            by_level = precision.sum(axis=2)
            total = by_level.sum(axis=1)
            mean = pull.sum(axis=1) / total
            own, common, level, scatter = (
                np.array([getattr(choice, name) ** 2 for choice, _ in of_family])
                for name in ("own", "common", "level", "scatter")
            )
            self._families.append(
                Family(
                    smooth,
                    length_mm,
                    np.array([weight for _, weight in of_family]),
                    own,
                    common,
                    level,
                    scatter,
                    precision,
                    pull - by_level * mean[:, None],
                    mean,
                    1 / total,
                )
            )

    def predict(self, places_mm: Array) -> tuple[Array, Array]:
        """Mean and variance (n,) of the common map, level included, at places (n, 2)."""
        means, variances = [], []
        for family in self._families:
            kernel = family.correlate(self.places_mm, places_mm)
            means.append(family.expect(kernel))
            variances.append(family.vary(kernel, np.ones(len(places_mm))) - (family.own + family.level)[:, None])
        return mix_members(np.concatenate([family.weights for family in self._families]), means, variances)

    def covary(self, places_mm: Array) -> tuple[Array, Array, Array]:
        """Weights (m,) of the members, variances (m,) of single loads, and covariances (m, n, n) at places (n, 2)."""
        covariances = []
        for family in self._families:
            kernel = family.correlate(self.places_mm, places_mm)
            covariances.append(family.covary(kernel, kernel, family.correlate(places_mm, places_mm)))
        weights, scatter = (
            np.concatenate([getattr(family, name) for family in self._families]) for name in ("weights", "scatter")
        )
        return weights, scatter, np.concatenate(covariances)

    def expect_variance(self, pressed_mm: Array, places_mm: Array) -> Array:
        """Variance (n,) at places of a sensor's map after presses (m, 2) that only scatter, before they are made."""
        variances = []
        for family in self._families:
            kernel = family.correlate(self.places_mm, places_mm)
            variance = family.vary(kernel, np.ones(len(places_mm)))
            if len(pressed_mm):
                loads = SensorLoads(pressed_mm, np.zeros(len(pressed_mm)), np.zeros(len(pressed_mm)))
                part, between = (
                    condition_members(family, self.places_mm, loads),
                    family.correlate(pressed_mm, places_mm),
                )
                cross = family.covary(family.correlate(self.places_mm, pressed_mm), kernel, between)
                variance = variance - (np.linalg.solve(part.root, cross) ** 2).sum(axis=1)
            variances.append(variance)
        weights = np.concatenate([family.weights for family in self._families])
        expected: Array = weights @ np.concatenate(variances)
        return np.maximum(expected, 0.0)

    def learn_response(self, loads: SensorLoads) -> "BatchMap":
        """Return the map of a sensor of the batch by its loads: exact for each member; the members weighted anew."""
        conditioned = [condition_members(family, self.places_mm, loads) for family in self._families]
        log_weights = [np.log(part.family.weights) + part.log_likelihood(part.surprise) for part in conditioned]
        total = logsumexp(np.concatenate(log_weights))
        weights = [np.exp(logs - total) for logs in log_weights]
        kept = []
        for part, weight in zip(conditioned, weights, strict=True):
            which = weight > _NEGLIGIBLE
            if which.any():
                family = replace(part.family, weights=weight).select(which)
                kept.append(ConditionedFamily(family, part.root[which], part.expected[which], part.surprise[which]))
        return BatchMap(self.places_mm, loads, tuple(kept))

    def test_likeness(self, loads: SensorLoads, draws: int = DRAWS) -> Likeness:
        """Test whether a sensor is of the batch, against one that shares only how its map varies.

        By Neyman and Pearson's lemma no test of this size finds more of those; its distribution is drawn.

        Parameters
        ----------
        draws : number; no p value is below 1/(draws + 1).
        """
        like = [condition_members(family, self.places_mm, loads) for family in self._families]
        strange = [condition_members(family.make_stranger(), self.places_mm, loads) for family in self._families]
        values = np.column_stack([loads.log_response, self._draw_loads(like, draws)])
        evidence = _weigh_evidence(like, values) - _weigh_evidence(strange, values)
        further = np.count_nonzero(evidence[1:] <= evidence[0])
        return Likeness((further + 1) / len(evidence), float(evidence[0]))

    def _draw_loads(self, parts: Sequence[ConditionedFamily], draws: int) -> Array:
        """Draw values of loads (n, draws) of further sensors of the batch."""
        random = np.random.default_rng([_SEED, len(self.places_mm), parts[0].root.shape[1]])
        weights = np.concatenate([part.family.weights for part in parts])
        counts = np.split(random.multinomial(draws, weights), np.cumsum([len(part.root) for part in parts])[:-1])
        drawn = [
            mean[:, None] + root @ random.standard_normal((len(root), count))
            for part, of_part in zip(parts, counts, strict=True)
            for root, mean, count in zip(part.root, part.expected, of_part, strict=True)
        ]
        return np.concatenate(drawn, axis=1)


def _weigh_evidence(parts: Sequence[ConditionedFamily], values: Array) -> Array:
    """Logarithm of the likelihood (k,) of values (n, k) of loads, the members weighted."""
    logs = [
        np.log(part.family.weights)[:, None]
        + part.log_likelihood(np.asarray(np.linalg.solve(part.root, values - part.expected[:, :, None])))
        for part in parts
    ]
    evidence: Array = logsumexp(np.concatenate(logs), axis=0)
    return evidence
