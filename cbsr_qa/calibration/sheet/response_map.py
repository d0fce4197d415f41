"""Response of each place of a sheet: loads at some places, a Gaussian process in between.

The logarithm of the response is modelled as a Gaussian process over the sheet with an unknown mean. Its length, its
deviation and the scatter of single loads are not chosen: a grid of them is weighted by the likelihood of the loads
(Rasmussen & Williams 2006, 5.2 and 2.7), so that few loads give wide intervals. Away from data the map returns to the
mean response, which, since responses are relative to the field of the head itself, is the forward model's own
sensitivity.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from cbsr_qa.calibration.sheet.response_processes import (
    Process,
    combine_loads,
    compute_covariance,
    condition_family,
    covary_processes,
    predict_processes,
)
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.results.calibration import BatchUse, ForceModel
from cbsr_qa.domain.sensor.sensor_type import QuasiStatic

#: Correlation lengths of the response, over the sheet's radius.
_LENGTHS: Final = np.array([0.16, 0.22, 0.3, 0.4, 0.54, 0.72, 1.0, 1.4])
#: Relative scatter of single loads beyond their noise.
_SCATTERS: Final = np.array([0.0, 0.005, 0.01, 0.02, 0.04])
#: Least weight of members that are kept. Members are many after few loads: at 1e-4 those dropped made stated errors
#: 4 % too small with ten loads.
_NEGLIGIBLE: Final = 1e-5
#: Largest relative error of an amplitude that determines its logarithm.
LARGEST_ERROR: Final = 0.3
#: Variance that keeps the covariance of noiseless loads at one place invertible.
_ROUNDING: Final = 1e-12
#: An intercept is separable from the map if loads press so differently; prior error of an intercept.
_SPREAD: Final = 2.0
_UNKNOWN_INTERCEPT: Final = 0.02
#: Fewest loads for a map: with fewer not even the mean has an honest error.
FEWEST: Final = 3


@dataclass(frozen=True, eq=False)
class ResponseMap:
    """A learned map.

    Parameters
    ----------
    places_mm : (p, 2) places of the loads, each once.
    members, weights : the processes and their posterior weights, with sum one.
    batch : batch that the sensor was compared with and is not like; None if there was none.
    """

    places_mm: Array
    members: tuple[Process, ...]
    weights: Array
    batch: BatchUse | None = None

    def predict(self, places_mm: Array) -> tuple[Array, Array]:
        """Mean and variance (n,) of the logarithm of the response at places (n, 2), without the scatter of loads."""
        means, variances = self.predict_members(places_mm)
        mean: Array = self.weights @ means
        variance: Array = self.weights @ (variances + (means - mean) ** 2)
        return mean, np.maximum(variance, 0.0)

    def predict_members(self, places_mm: Array) -> tuple[Array, Array]:
        """Means and variances (m, n) of each member at places (n, 2)."""
        means, variances = (np.empty((len(self.members), len(places_mm))) for _ in range(2))
        for (smooth, length_mm), among, members in self._group_by_kernel():
            kernel = compute_covariance(self.places_mm, places_mm, length_mm, smooth)
            means[among], variances[among] = predict_processes(members, kernel)
        return means, variances

    def covariance(self, places_mm: Array, others_mm: Array) -> Array:
        """Posterior covariance (m, n, t) of each member, of places (n, 2) with others (t, 2)."""
        covariances = np.empty((len(self.members), len(places_mm), len(others_mm)))
        for (smooth, length_mm), among, members in self._group_by_kernel():
            to_places, to_others = (
                compute_covariance(self.places_mm, mm, length_mm, smooth) for mm in (places_mm, others_mm)
            )
            mutual = compute_covariance(places_mm, others_mm, length_mm, smooth)
            covariances[among] = covary_processes(members, (to_places, to_others), mutual)
        return covariances

    def variance_after(self, candidates_mm: Array, targets_mm: Array, variance: float) -> Array:
        """Variance (m, n, t) of each member at targets (t, 2) after one more load at each candidate (n, 2).

        The hyperparameters of a member stay as they are, so that the load changes its variance by one rank:
        v(t) − c(x, t)² / (v(x) + variance + scatter²). The load is one of the calibration's middle stress, which the
        line's intercept does not change.

        Parameters
        ----------
        variance : variance of the logarithm of the new load's response, by noise.
        """
        _, at_candidates = self.predict_members(candidates_mm)
        _, at_targets = self.predict_members(targets_mm)
        scatter = np.array([member.scatter for member in self.members])
        observed = at_candidates + (variance + scatter**2 + _ROUNDING)[:, None]
        after = at_targets[:, None] - self.covariance(candidates_mm, targets_mm) ** 2 / observed[:, :, None]
        return np.maximum(after, 0.0)

    def _group_by_kernel(self) -> Iterator[tuple[tuple[bool, float], list[int], list[Process]]]:
        """Yield each kind and length of kernel with its members and their numbers."""
        kinds = [(member.smooth, member.length_mm) for member in self.members]
        for kind in dict.fromkeys(kinds):
            among = [number for number, other in enumerate(kinds) if other == kind]
            yield kind, among, [self.members[number] for number in among]

    @cached_property
    def scatter(self) -> float:
        """Relative scatter of single loads, root mean square over the members."""
        return float(np.sqrt(self.weights @ np.array([member.scatter**2 for member in self.members])))

    @cached_property
    def bend(self) -> tuple[float, float]:
        """Coefficient of the second column of the mean and its variance; zeros without one."""
        if self.members[0].drift.shape[1] < 2:
            return 0.0, 0.0
        values = np.array([member.mean[1] for member in self.members])
        inverses = [
            solve_triangular(member.mean_root, np.eye(len(member.mean_root)), lower=True) for member in self.members
        ]
        own_variances = np.array([(inverse**2).sum(axis=0)[1] for inverse in inverses])
        mean = float(self.weights @ values)
        return mean, float(self.weights @ (own_variances + (values - mean) ** 2))


def learn_response(
    places_mm: Array,
    log_response: Array,
    variance: Array,
    *,
    radius_mm: float,
    bend: Array | None = None,
    bend_stderr: float = 1.0,
) -> ResponseMap:
    """Learn the map from single loads.

    CalibrationError with fewer than 3 loads, or a place, response or variance that is not finite.

    Parameters
    ----------
    places_mm : (n, 2) places of the loads.
    log_response : (n,) logarithm of the observed change over that of the quasi-static line.
    variance : (n,) variance of that logarithm, by the readings' and the force's noise.
    radius_mm : radius of the sheet, the unit of the correlation lengths.
    bend : (n,) a column with an unknown multiple in the logarithm, the effect of a wrong intercept of the line; None
        without one.
    bend_stderr : prior standard deviation of that multiple.
    """
    if len(log_response) < FEWEST:
        raise CalibrationError(
            f"{len(log_response)} loads determine the response of the sheet; a map needs at least {FEWEST}",
            remedy="press more places, or press harder: loads must stand out of the noise",
        )
    if not (np.isfinite(places_mm).all() and np.isfinite(log_response).all() and (variance >= 0).all()):
        raise CalibrationError(
            "the place, response or variance of a load is not a finite number",
            remedy="leave the load out, or press it again",
        )
    columns = np.ones((len(log_response), 1)) if bend is None else np.column_stack([np.ones(len(bend)), bend])
    prior_precision = np.zeros(1) if bend is None else np.array([0.0, 1 / bend_stderr**2])
    places, which = find_places(places_mm)
    columns_and_values = np.column_stack([columns, log_response])
    data = {
        float(scatter): combine_loads(
            which, columns_and_values, variance + scatter**2 + _ROUNDING, np.diag(prior_precision)
        )
        for scatter in _SCATTERS
    }
    families = [
        condition_family(data, compute_covariance(places, places, length_mm, smooth), smooth, length_mm)
        for smooth in (True, False)
        for length_mm in [float(length * radius_mm) for length in _LENGTHS]
    ]
    score = np.array([family.score for family in families])
    weights = np.exp(score - score.max())
    kept_mask = weights > _NEGLIGIBLE * weights.sum()
    members = tuple(families[family].member(*which) for family, *which in np.argwhere(kept_mask).tolist())
    return ResponseMap(places, members, weights[kept_mask] / weights[kept_mask].sum())


def intercept_column(line: QuasiStatic, pressed: Array, predicted: Array) -> tuple[Array | None, float, float]:
    """Return the effect of an unknown error of a line's intercept on the logarithms of (n,) loads.

    Parameters
    ----------
    pressed, predicted : (n,) stress or strain of the loads, and the change that the line predicts.

    Returns
    -------
    The column (n,), or None if loads are too similar to separate the intercept from the map; its prior standard
    deviation; and the change in the middle, about which the line turns.
    """
    middle = float(np.exp(np.log(np.abs(predicted)).mean()) * np.sign(predicted[0])) if len(predicted) else 1.0
    if not len(pressed) or pressed.max() < _SPREAD * pressed.min():
        return None, line.intercept.stderr or 0.0, middle
    return 1 / predicted - 1 / middle, line.intercept.stderr or _UNKNOWN_INTERCEPT, middle


def find_places(places_mm: Array) -> tuple[Array, NDArray[np.intp]]:
    """Places (p, 2), each once in the order of the loads, and the index of each load's place (n,)."""
    _, first_loads, place_index = np.unique(places_mm, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first_loads)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return places_mm[first_loads[order]], rank[place_index.ravel()]


def average_response(response: ResponseMap, places_mm: Array) -> tuple[float, float]:
    """Mean over places (n, 2) of the logarithm of the response, and its variance."""
    means, variances = [], []
    kinds = {(member.smooth, member.length_mm) for member in response.members}
    cross_means, mutual_means = (
        {kind: compute_covariance(places, places_mm, kind[1], kind[0]).mean(axis=1, keepdims=True) for kind in kinds}
        for places in (response.places_mm, places_mm)
    )
    for member in response.members:
        kind = member.smooth, member.length_mm
        whitened_kernel = member.solve_kernel(member.deviation**2 * cross_means[kind])[:, 0]
        columns = np.zeros(member.drift.shape[1])
        columns[0] = 1
        spread = solve_triangular(member.mean_root, columns - member.drift.T @ whitened_kernel, lower=True)
        means.append(float(columns @ member.mean + whitened_kernel @ (member.data - member.drift @ member.mean)))
        variances.append(
            member.deviation**2 * float(mutual_means[kind].mean())
            - float(whitened_kernel @ whitened_kernel)
            + float(spread @ spread)
        )
    mean = float(response.weights @ np.array(means))
    variance = float(response.weights @ (np.array(variances) + (np.array(means) - mean) ** 2))
    return mean, max(variance, 0.0)


def sheet_places(model: ForceModel, *, stride: int = 4) -> Array:
    """Every ``stride``-th place (n, 2) of the lattice, along both axes, with the head clear of edge and pins."""
    node = np.full(model.node.shape, -1)
    node[::stride, ::stride] = model.node[::stride, ::stride]
    chosen_mask = node.ravel() >= 0
    chosen_mask[chosen_mask] = model.fits[node.ravel()[chosen_mask]]
    return model.lattice.places_mm()[chosen_mask]
