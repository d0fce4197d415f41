"""Posterior of a batch's hyperparameters, on a lattice as fine as the batch's loads tell them apart.

Lattice coordinates are the kind and length of the correlation, the scatter of loads, the deviation ϖ of single maps,
ζ = ln(1 + S ρ/(1 − ρ)) for the share ρ that S sensors have in common, and the deviation τ of levels. The standard
error of ζ hardly depends on ρ. The lattice is filled outwards from its best point until neighbours are negligible, so
that only a few thousand of its points are computed.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.calibration.batch.likelihood import BatchLikelihood, Hyperparameters
from cbsr_qa.calibration.batch.loads import BatchLoads
from cbsr_qa.calibration.sheet.response_processes import USUAL_DEVIATION, USUAL_SCATTER
from cbsr_qa.domain.numbers import Array, Indices

#: Correlation lengths over the sheet's radius.
_LENGTHS: Final = np.geomspace(0.16, 1.4, 15)
#: Relative scatters of single loads. A larger one takes short variation of the map for scatter.
_SCATTERS: Final = np.array([0.0, 0.0025, 0.005, 0.01, 0.02, 0.04])
_LEVELS: Final = np.concatenate([[0.0], 0.005 * 2.0 ** np.arange(7)])
#: Least and largest deviation of single maps, and largest of maps altogether. The least is far below the
#: repeatability of any press: such sensors are identical.
_OWN: Final = (0.001, 1.5)
_LARGEST: Final = 2.0
#: Scale of the prior of the deviation of levels (half Cauchy). Chosen by us.
_USUAL_LEVEL: Final = 0.05
#: Steps of a lattice over the standard error of a coordinate, and their bounds.
_STEP: Final = 1.2
_STEPS_OWN: Final = (0.03, 0.25)
_STEPS_SHARE: Final = (0.15, 0.5)
#: Logarithm of the least weight, relative to the largest, from which a point's neighbours are computed.
_NEGLIGIBLE: Final = -9.0
#: Largest number of points of a lattice; loads that would fill more tell less apart than it does.
_MOST_POINTS: Final = 60_000
#: Distances of the points from which the best one is found, in steps of each coordinate.
_COARSE: Final = (1, 3, 3, 6, 3, 4)


@dataclass(frozen=True, slots=True, eq=False)
class Posterior:
    """Points of the lattice with their weights.

    Parameters
    ----------
    choices, weights : (m,) hyperparameters and posterior weights, with sum one.
    share, share_step : (m,) ζ of each, and the step of its lattice.
    sensors : S.
    log_evidence : logarithm of the sum of likelihood × prior over the lattice.
    """

    choices: tuple[Hyperparameters, ...]
    weights: Array
    share: Array
    share_step: float
    sensors: int
    log_evidence: float


class _Lattice:
    """Coordinates, and the prior's mass in each cell.

    Parameters
    ----------
    coarseness : factor on the usual distances of points.
    """

    def __init__(self, loads: BatchLoads, radius_mm: float, coarseness: int) -> None:
        self.sensors = len(loads.which)
        places = float(np.mean([len(which) for which in loads.which]))
        own_step = coarseness * float(np.clip(_STEP / np.sqrt(2 * self.sensors * places), *_STEPS_OWN))
        share_error = np.sqrt(2 / max(len(loads.places_mm) - 1, 1))
        self.share_step = coarseness * float(np.clip(_STEP * share_error, *_STEPS_SHARE))
        low, high = np.log(_OWN)
        owns = np.exp(np.linspace(low, high, int(np.ceil((high - low) / own_step)) + 1))
        most = np.log1p(self.sensors * (_LARGEST / _OWN[0]) ** 2)
        shares = np.arange(0.0, most, self.share_step)
        lengths_mm, scatters, levels = (axis[::coarseness] for axis in (_LENGTHS * radius_mm, _SCATTERS, _LEVELS))
        self.axes = [np.array([False, True]), lengths_mm, scatters, owns, shares, levels]
        self.size = np.array([len(axis) for axis in self.axes])

    def place(self, points: Indices) -> list[Array]:
        return [axis[points[:, number]] for number, axis in enumerate(self.axes)]

    def choices(self, points: Indices) -> list[Hyperparameters]:
        smooth, length_mm, scatter, own, share, level = self.place(points)
        common = own * np.sqrt(np.expm1(share) / self.sensors)
        columns = (column.tolist() for column in (smooth, length_mm, scatter, own, common, level))
        return [Hyperparameters(*values) for values in zip(*columns, strict=True)]

    def log_prior(self, points: Indices) -> Array:
        """Logarithm of the prior's density times the cell; −∞ outside of what it allows.

        Deviation and scatter have the priors of single maps. That of ρ is between a uniform one and Jeffreys' of an
        intraclass correlation, which is even in ζ: the square root of their product.
        """
        _, _, scatter, own, share, level = self.place(points)
        deviation = own * np.sqrt(1 + np.expm1(share) / self.sensors)
        density = np.log(deviation) - np.log1p((deviation / USUAL_DEVIATION) ** 2)
        density = density + np.log(slope_of_share(share, self.sensors)) / 2
        density = density - scatter / USUAL_SCATTER - np.log1p((level / _USUAL_LEVEL) ** 2)
        cells = [np.log(_measure_cells(self.axes[number])[points[:, number]]) for number in (2, 4, 5)]
        return np.where(deviation <= _LARGEST, density + np.sum(cells, axis=0), -np.inf)


def slope_of_share(share: Array, sensors: int) -> Array:
    """Slope dρ/dζ = (1 − ρ) ((1 − ρ)/S + ρ) at ζ."""
    ratio = np.expm1(share) / sensors
    slope: Array = (1 / sensors + ratio) / (1 + ratio) ** 2
    return slope


def find_posterior(likelihood: BatchLikelihood, radius_mm: float) -> Posterior:
    """Weigh the hyperparameters of a batch by the likelihood of its loads.

    Parameters
    ----------
    radius_mm : radius of the sheet, the unit of the correlation lengths.
    """
    coarseness = 1
    while (found := _fill(_Lattice(likelihood.loads, radius_mm, coarseness), likelihood)) is None:
        coarseness *= 2
    return found


def _fill(lattice: _Lattice, likelihood: BatchLikelihood) -> Posterior | None:
    """Fill a lattice outwards from its best points; None if it would take too many."""
    starts = [
        np.arange(min(step // 2, size - 1), size, step) for step, size in zip(_COARSE, lattice.size, strict=True)
    ]
    coarse = np.stack(np.meshgrid(*starts, indexing="ij"), axis=-1).reshape(-1, len(starts))
    scores = _score(lattice, likelihood, coarse)
    best_of_kind = [
        number
        for kind in (0, 1)
        for number in [np.flatnonzero(coarse[:, 0] == kind)]
        for number in number[np.argsort(-scores[number], kind="stable")[:3]]
    ]
    known = {tuple(coarse[number].tolist()): float(scores[number]) for number in best_of_kind}
    spread: set[tuple[int, ...]] = set()
    while frontier := _list_open(known, spread):
        if len(known) > _MOST_POINTS:
            return None
        spread.update(frontier)
        new = sorted({other for point in frontier for other in _list_neighbours(point, lattice.size)} - known.keys())
        if new:
            known.update(zip(new, _score(lattice, likelihood, np.array(new)).tolist(), strict=True))
    return _weigh(lattice, known)


def _score(lattice: _Lattice, likelihood: BatchLikelihood, points: Indices) -> Array:
    score = lattice.log_prior(points)
    possible = np.flatnonzero(np.isfinite(score))
    score[possible] += likelihood.compute(lattice.choices(points[possible]))
    return score


def _list_open(known: dict[tuple[int, ...], float], spread: set[tuple[int, ...]]) -> list[tuple[int, ...]]:
    """Points that matter and whose neighbours are not yet computed."""
    least = max(known.values()) + _NEGLIGIBLE
    return [point for point, score in known.items() if score > least and point not in spread]


def _list_neighbours(point: tuple[int, ...], size: NDArray[np.intp]) -> list[tuple[int, ...]]:
    return [
        (*point[:axis], point[axis] + step, *point[axis + 1 :])
        for axis in range(len(point))
        for step in (-1, 1)
        if 0 <= point[axis] + step < size[axis]
    ]


def _weigh(lattice: _Lattice, known: dict[tuple[int, ...], float]) -> Posterior:
    points, scores = np.array(sorted(known)), np.array([known[point] for point in sorted(known)])
    weights = np.exp(scores - scores.max())
    kept = weights > np.exp(_NEGLIGIBLE)
    log_evidence = float(np.log(weights[kept].sum()) + scores.max())
    points, weights = points[kept], weights[kept] / weights[kept].sum()
    shares = lattice.axes[4][points[:, 4]]
    return Posterior(
        tuple(lattice.choices(points)), weights, shares, lattice.share_step, lattice.sensors, log_evidence
    )


def _measure_cells(nodes: Array) -> Array:
    """Lengths of the cells around nodes (trapezoidal rule)."""
    edges = np.concatenate([nodes[:1], (nodes[1:] + nodes[:-1]) / 2, nodes[-1:]])
    return np.diff(edges)
