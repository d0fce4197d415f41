"""What a learned map says of the sheet as a whole: its mean response, with the error of that mean."""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from cbsr_qa.calibrate.response_map import ResponseMap, _covariance
from cbsr_qa.domain.force_model import ForceModel

Array = NDArray[np.float64]


def average_response(response: ResponseMap, places_mm: Array) -> tuple[float, float]:
    """Mean over places (n, 2) of the logarithm of the response, and its variance.

    The variance is that of a mean of correlated values, exact for each process of the mixture, with what the
    processes differ by added (law of total variance). Pointwise errors would say nothing of it: where data end they
    are alike and of one sign.
    """
    means, variances = [], []
    for member in response.members:
        between = _covariance(response.places_mm, places_mm, member.length_mm, member.smooth)
        among = _covariance(places_mm, places_mm, member.length_mm, member.smooth)
        seen = member.seen(member.deviation**2 * between.mean(axis=1, keepdims=True))[:, 0]
        columns = np.zeros(member.drift.shape[1])
        columns[0] = 1
        spread = solve_triangular(member.mean_root, columns - member.drift.T @ seen, lower=True)
        means.append(float(columns @ member.mean + seen @ (member.data - member.drift @ member.mean)))
        variances.append(member.deviation**2 * float(among.mean()) - float(seen @ seen) + float(spread @ spread))
    mean = float(response.weights @ np.array(means))
    variance = float(response.weights @ (np.array(variances) + (np.array(means) - mean) ** 2))
    return mean, max(variance, 0.0)


def sheet_places(model: ForceModel, *, stride: int = 4) -> Array:
    """Every ``stride``-th place (n, 2) of the lattice, along both axes, where the head is clear of edge and pins."""
    kept = np.full(model.node.shape, -1)
    kept[::stride, ::stride] = model.node[::stride, ::stride]
    there = kept.ravel() >= 0
    there[there] = model.fits[kept.ravel()[there]]
    return model.lattice.places_mm()[there]
