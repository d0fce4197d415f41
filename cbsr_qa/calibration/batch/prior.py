"""The batch as prior of one more sensor: what its map is before a press, and after some."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby
from typing import Final

import numpy as np
from scipy.special import logsumexp

from cbsr_qa.calibration.batch.likelihood import BatchLikelihood, Hyperparameters
from cbsr_qa.calibration.batch.loads import ROUNDING, SensorLoads
from cbsr_qa.calibration.sheet.response_processes import compute_covariance
from cbsr_qa.domain.numbers import Array, Mask
from cbsr_qa.domain.results.calibration import BatchUse

#: Least weight of members that are kept for a sensor.
_NEGLIGIBLE: Final = 1e-5
#: Deviation of the level of a sensor that is not of the batch. Chosen by us.
_STRANGE_LEVEL: Final = 0.5
#: Number of draws of a test, and what they are seeded with.
DRAWS: Final = 999
_SEED: Final = 52


@dataclass(frozen=True, slots=True, eq=False)
class _Family:
    """Members of one kind and length of correlation.

    Parameters
    ----------
    weights : (m,) of all members, with sum one over all families.
    own, common, level, scatter : (m,) variances ϖ², ω², τ² and that of single loads.
    precision, pull : G (m, p, p), and q − G 1 μ (m, p).
    mean, mean_variance : (m,) of the level μ.
    """

    smooth: bool
    length_mm: float
    weights: Array
    own: Array
    common: Array
    level: Array
    scatter: Array
    precision: Array
    pull: Array
    mean: Array
    mean_variance: Array

    def correlate(self, one_mm: Array, other_mm: Array) -> Array:
        return compute_covariance(one_mm, other_mm, self.length_mm, self.smooth)

    def expect(self, kernel: Array) -> Array:
        """Mean (m, n) of μ + c at places whose correlations with those of the batch are ``kernel`` (p, n)."""
        mean: Array = self.mean[:, None] + self.common[:, None] * (self.pull @ kernel)
        return mean

    def covary(self, one: Array, other: Array, mutual: Array) -> Array:
        """Prior covariance (m, n, k) of the sensor's map at places of kernels (p, n) and (p, k)."""
        common = self.common[:, None, None]
        by_level, other_by_level = self._left_to_level(one), self._left_to_level(other)
        known = common**2 * (one.T @ self.precision @ other)
        level = self.mean_variance[:, None, None] * by_level[:, :, None] * other_by_level[:, None, :]
        covariance: Array = (common + self.own[:, None, None]) * mutual - known + level + self.level[:, None, None]
        return covariance

    def vary(self, kernel: Array, mutual: Array) -> Array:
        """Prior variance (m, n), the diagonal of ``covary``."""
        common = self.common[:, None]
        known = common**2 * ((self.precision @ kernel) * kernel).sum(axis=1)
        level = self.mean_variance[:, None] * self._left_to_level(kernel) ** 2
        variance: Array = (common + self.own[:, None]) * mutual - known + level + self.level[:, None]
        return variance

    def _left_to_level(self, kernel: Array) -> Array:
        left: Array = 1 - self.common[:, None] * (self.precision.sum(axis=2) @ kernel)
        return left

    def select(self, which: Mask) -> "_Family":
        names = ("own", "common", "level", "scatter", "precision", "pull", "mean", "mean_variance")
        return replace(self, weights=self.weights[which], **{name: getattr(self, name)[which] for name in names})

    def with_known_map(self) -> "_Family":
        """The family if the common level and map were exactly known; only its covariances are meaningful."""
        return replace(self, common=0 * self.common, mean_variance=0 * self.mean_variance)

    def of_stranger(self) -> "_Family":
        """The family of a sensor that has nothing in common with the batch but how its map varies."""
        return replace(
            self, own=self.own + self.common, common=0 * self.common, level=0 * self.level + _STRANGE_LEVEL**2
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Conditioned:
    """A family after a sensor's loads.

    Parameters
    ----------
    root : (m, n, n) Cholesky factors of the loads' covariance.
    expected : (m, n) means of the loads.
    surprise : (m, n) what they differ by from those means, whitened.
    """

    family: _Family
    root: Array
    expected: Array
    surprise: Array

    def log_likelihood(self, surprise: Array) -> Array:
        """Logarithm of the likelihood (m, …) of whitened values (m, n, …)."""
        squared: Array = (surprise**2).sum(axis=1)
        log_determinant = 2 * np.log(np.diagonal(self.root, axis1=1, axis2=2)).sum(axis=1)
        constant = log_determinant + surprise.shape[1] * np.log(2 * np.pi)
        likelihood: Array = -(squared + constant.reshape(-1, *[1] * (squared.ndim - 1))) / 2
        return likelihood


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
                _Family(
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
        return _mix(np.concatenate([family.weights for family in self._families]), means, variances)

    def expect_variance(self, pressed_mm: Array, places_mm: Array) -> Array:
        """Variance (n,) at places of a sensor's map after presses (m, 2) that only scatter, before they are made."""
        variances = []
        for family in self._families:
            kernel = family.correlate(self.places_mm, places_mm)
            variance = family.vary(kernel, np.ones(len(places_mm)))
            if len(pressed_mm):
                loads = SensorLoads(pressed_mm, np.zeros(len(pressed_mm)), np.zeros(len(pressed_mm)))
                part, between = _condition(family, self.places_mm, loads), family.correlate(pressed_mm, places_mm)
                cross = family.covary(family.correlate(self.places_mm, pressed_mm), kernel, between)
                variance = variance - (np.linalg.solve(part.root, cross) ** 2).sum(axis=1)
            variances.append(variance)
        weights = np.concatenate([family.weights for family in self._families])
        expected: Array = weights @ np.concatenate(variances)
        return np.maximum(expected, 0.0)

    def learn_response(self, loads: SensorLoads) -> "BatchMap":
        """Return the map of a sensor of the batch by its loads: exact for each member; the members weighted anew."""
        conditioned = [_condition(family, self.places_mm, loads) for family in self._families]
        log_weights = [np.log(part.family.weights) + part.log_likelihood(part.surprise) for part in conditioned]
        total = logsumexp(np.concatenate(log_weights))
        weights = [np.exp(logs - total) for logs in log_weights]
        kept = []
        for part, weight in zip(conditioned, weights, strict=True):
            which = weight > _NEGLIGIBLE
            if which.any():
                family = replace(part.family, weights=weight).select(which)
                kept.append(_Conditioned(family, part.root[which], part.expected[which], part.surprise[which]))
        return BatchMap(self.places_mm, loads, tuple(kept))

    def test_likeness(self, loads: SensorLoads, draws: int = DRAWS) -> Likeness:
        """Test whether a sensor is of the batch, against one that shares only how its map varies.

        By Neyman and Pearson's lemma no test of this size finds more of those; its distribution is drawn.

        Parameters
        ----------
        draws : number; no p value is below 1/(draws + 1).
        """
        like = [_condition(family, self.places_mm, loads) for family in self._families]
        strange = [_condition(family.of_stranger(), self.places_mm, loads) for family in self._families]
        values = np.column_stack([loads.log_response, self._draw_loads(like, draws)])
        evidence = _weigh_evidence(like, values) - _weigh_evidence(strange, values)
        further = np.count_nonzero(evidence[1:] <= evidence[0])
        return Likeness((further + 1) / len(evidence), float(evidence[0]))

    def _draw_loads(self, parts: Sequence[_Conditioned], draws: int) -> Array:
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


class BatchMap:
    """A sensor's map by the batch and its own loads.

    It answers what a :class:`~cbsr_qa.calibration.sheet.response_map.ResponseMap` answers.
    """

    def __init__(self, batch_places_mm: Array, loads: SensorLoads, parts: tuple[_Conditioned, ...]) -> None:
        self._batch_places_mm, self._loads, self._parts = batch_places_mm, loads, parts
        self._weights = np.concatenate([part.family.weights for part in parts])
        self._weights /= self._weights.sum()
        #: What it owes to the batch, as its calibration states it.
        self.batch: BatchUse | None = None

    @property
    def weights(self) -> Array:
        """Posterior weights (m,) of the members, with sum one."""
        return self._weights

    def predict_members(self, places_mm: Array) -> tuple[Array, Array]:
        """Means and variances (m, n) of each member at places (n, 2)."""
        described = [self._describe(part, places_mm, average=False) for part in self._parts]
        return np.concatenate([mean for mean, _ in described]), np.concatenate(
            [variance for _, variance in described]
        )

    def covariance(self, places_mm: Array, others_mm: Array) -> Array:
        """Posterior covariance (m, n, t) of each member, of places (n, 2) with others (t, 2)."""
        parts = []
        for part in self._parts:
            family, own_mm = part.family, self._loads.places_mm
            at_places, at_others, at_own = (
                family.correlate(self._batch_places_mm, mm) for mm in (places_mm, others_mm, own_mm)
            )
            whitened, whitened_other = (
                np.linalg.solve(part.root, family.covary(at_own, kernel, family.correlate(own_mm, mm)))
                for kernel, mm in ((at_places, places_mm), (at_others, others_mm))
            )
            prior = family.covary(at_places, at_others, family.correlate(places_mm, others_mm))
            parts.append(prior - np.swapaxes(whitened, 1, 2) @ whitened_other)
        return np.concatenate(parts)

    def variance_after(self, candidates_mm: Array, targets_mm: Array, variance: float) -> Array:
        """Variance (m, n, t) of each member at targets (t, 2) after one more load at each candidate (n, 2).

        As of :meth:`~cbsr_qa.calibration.sheet.response_map.ResponseMap.variance_after`.
        """
        _, at_candidates = self.predict_members(candidates_mm)
        _, at_targets = self.predict_members(targets_mm)
        scatter = np.concatenate([part.family.scatter for part in self._parts])
        observed = at_candidates + (variance + scatter + ROUNDING)[:, None]
        after = at_targets[:, None] - self.covariance(candidates_mm, targets_mm) ** 2 / observed[:, :, None]
        return np.maximum(after, 0.0)

    def predict(self, places_mm: Array) -> tuple[Array, Array]:
        """Mean and variance (n,) of the logarithm of the response at places (n, 2), without the scatter of loads."""
        return self._predict(self._parts, places_mm, average=False)

    def average(self, places_mm: Array) -> tuple[float, float]:
        """Mean over places (n, 2) of the logarithm of the response, and its variance."""
        mean, variance = self._predict(self._parts, places_mm, average=True)
        return float(mean[0]), float(variance[0])

    def batch_share(self, places_mm: Array) -> Array:
        """Share (n,) of the variance at places (n, 2) that would be gone if the common map were exactly known."""
        known = []
        for part in self._parts:
            family = part.family.with_known_map()
            known.append(_condition(family, self._batch_places_mm, self._loads))
        variances = [self._describe(part, places_mm, average=False)[1] for part in (*self._parts, *known)]
        full, left = (
            self._weights @ np.concatenate(part)
            for part in (variances[: len(self._parts)], variances[len(self._parts) :])
        )
        share: Array = np.clip(1 - left / full, 0.0, 1.0)
        return share

    @cached_property
    def scatter(self) -> float:
        """Relative scatter of single loads, root mean square over the members."""
        return float(np.sqrt(self._weights @ np.concatenate([part.family.scatter for part in self._parts])))

    @cached_property
    def bend(self) -> tuple[float, float]:
        """Multiple of the effect of a wrong intercept, and its variance; zeros without one."""
        if self._loads.bend is None:
            return 0.0, 0.0
        prior = self._loads.bend_stderr**2
        means, variances = [], []
        for part in self._parts:
            whitened = np.linalg.solve(part.root, self._loads.bend)
            means.append(prior * (whitened * part.surprise).sum(axis=1, keepdims=True))
            variances.append(prior - prior**2 * (whitened**2).sum(axis=1, keepdims=True))
        mean, variance = _mix(self._weights, means, variances)
        return float(mean[0]), float(variance[0])

    def _predict(self, parts: Sequence[_Conditioned], places_mm: Array, *, average: bool) -> tuple[Array, Array]:
        described = [self._describe(part, places_mm, average=average) for part in parts]
        return _mix(self._weights, [mean for mean, _ in described], [variance for _, variance in described])

    def _describe(self, part: _Conditioned, places_mm: Array, *, average: bool) -> tuple[Array, Array]:
        """Means and variances (m, n) of the members; of the mean over the places if ``average``."""
        family, own_mm = part.family, self._loads.places_mm
        kernel, cross = family.correlate(self._batch_places_mm, places_mm), family.correlate(own_mm, places_mm)
        mutual = np.ones(len(places_mm))
        if average:
            kernel, cross = kernel.mean(axis=1, keepdims=True), cross.mean(axis=1, keepdims=True)
            mutual = np.array([family.correlate(places_mm, places_mm).mean()])
        covariance = family.covary(family.correlate(self._batch_places_mm, own_mm), kernel, cross)
        whitened = np.linalg.solve(part.root, covariance)
        means = family.expect(kernel) + (part.surprise[:, None] @ whitened)[:, 0]
        return means, family.vary(kernel, mutual) - (whitened**2).sum(axis=1)


def _condition(family: _Family, batch_places_mm: Array, loads: SensorLoads) -> _Conditioned:
    kernel = family.correlate(batch_places_mm, loads.places_mm)
    covariance = family.covary(kernel, kernel, family.correlate(loads.places_mm, loads.places_mm))
    noise = loads.variance + family.scatter[:, None] + ROUNDING
    covariance += noise[:, :, None] * np.eye(len(loads.variance))
    if loads.bend is not None:
        covariance += loads.bend_stderr**2 * np.outer(loads.bend, loads.bend)
    root = np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
    expected = family.expect(kernel)
    surprise = np.linalg.solve(root, (loads.log_response - expected)[:, :, None])[:, :, 0]
    return _Conditioned(family, root, expected, np.asarray(surprise, dtype=np.float64))


def _weigh_evidence(parts: Sequence[_Conditioned], values: Array) -> Array:
    """Logarithm of the likelihood (k,) of values (n, k) of loads, the members weighted."""
    logs = [
        np.log(part.family.weights)[:, None]
        + part.log_likelihood(np.asarray(np.linalg.solve(part.root, values - part.expected[:, :, None])))
        for part in parts
    ]
    evidence: Array = logsumexp(np.concatenate(logs), axis=0)
    return evidence


def _mix(weights: Array, means: Sequence[Array], variances: Sequence[Array]) -> tuple[Array, Array]:
    """Mean and variance (n,) of a mixture of members (m, n)."""
    all_means = np.concatenate(means)
    mean: Array = weights @ all_means
    variance: Array = weights @ (np.concatenate(variances) + (all_means - mean) ** 2)
    return mean, np.maximum(variance, 0.0)
