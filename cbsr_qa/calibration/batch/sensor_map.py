"""The map of one sensor by its batch and its own loads."""

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from cbsr_qa.calibration.batch.families import ConditionedFamily, condition_members, mix_members
from cbsr_qa.calibration.batch.loads import ROUNDING, SensorLoads
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.results.calibration import BatchUse


class BatchMap:
    """A sensor's map by the batch and its own loads.

    It answers what a :class:`~cbsr_qa.calibration.sheet.response_map.ResponseMap` answers.
    """

    def __init__(self, batch_places_mm: Array, loads: SensorLoads, parts: tuple[ConditionedFamily, ...]) -> None:
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
            known.append(condition_members(family, self._batch_places_mm, self._loads))
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
        mean, variance = mix_members(self._weights, means, variances)
        return float(mean[0]), float(variance[0])

    def _predict(self, parts: Sequence[ConditionedFamily], places_mm: Array, *, average: bool) -> tuple[Array, Array]:
        described = [self._describe(part, places_mm, average=average) for part in parts]
        return mix_members(self._weights, [mean for mean, _ in described], [variance for _, variance in described])

    def _describe(self, part: ConditionedFamily, places_mm: Array, *, average: bool) -> tuple[Array, Array]:
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
