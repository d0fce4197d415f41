"""Hard cases of smoothness priors: a free constant, and almost no λ."""

from functools import lru_cache, partial
from typing import Any, Final

import numpy as np
from mpmath import mp
from numpy.typing import NDArray
from scipy import linalg

from cbsr_qa.domain import NumericsError
from cbsr_qa.domain.sensor import Mesh, adjacent_pattern
from cbsr_qa.eit.forward import ForwardModel
from cbsr_qa.eit.inverse import dual_matrix, laplace
from cbsr_qa.studies.hard_cases.case import Answer, HardCase, conditioned_bound
from cbsr_qa.studies.hard_cases.cases.reconstruction import ridge_condition
from cbsr_qa.studies.hard_cases.sheets import RADIUS_MM, prepared, ring_mesh, usual_problem

Array = NDArray[np.float64]

_AREA: Final = "reconstruction"
_SEED: Final = 20261122
_DIGITS: Final = 50
#: Of the sheet: 168 elements, 54 independent readings whose singular values span four decades and a half.
_ELECTRODES, _RINGS = 12, 4


@lru_cache(maxsize=1)
def _sheet() -> tuple[Mesh, Array]:
    """A sheet that fifty digits can be had of, and its Jacobian: of reciprocal readings the one driven first."""
    mesh = ring_mesh(RADIUS_MM * np.arange(1, _RINGS + 1) / _RINGS, 2 * _ELECTRODES, _ELECTRODES, 1)
    ones, contacts = np.ones(len(mesh.elements)), np.full(_ELECTRODES, 5.0)
    model = ForwardModel(mesh, adjacent_pattern(_ELECTRODES), ones, contacts)
    used = model.pattern.usable() & np.triu(np.ones(model.pattern.shape, dtype=np.bool_))
    return mesh, model.jacobian()[used]


def smooth(relative: float) -> Answer:
    """Image with the Laplace prior against (JᵀJ + λ²R)⁻¹Jᵀy in fifty digits.

    Parameters
    ----------
    relative : λ over the largest singular value of JR^−½, without what a constant image explains.
    """
    mesh, jacobian = _sheet()
    differences = _differences(mesh)
    sizes = _sizes(jacobian, differences)
    value = relative * float(sizes[0])
    readings = np.random.default_rng(_SEED).standard_normal(len(jacobian))
    found = dual_matrix(jacobian, laplace(mesh), value) @ readings
    exact = _exact(jacobian, differences, value, readings)
    condition = ridge_condition(sizes, value)
    error = float(np.linalg.norm(found - exact) / np.linalg.norm(exact))
    return Answer(error, conditioned_bound(condition), condition)


def _differences(mesh: Mesh) -> Array:
    """Rows (edges, e) whose squares the prior adds up, twice."""
    rows = np.zeros((len(mesh.neighbours), len(mesh.elements)))
    for row, (one, other) in zip(rows, mesh.neighbours, strict=True):
        row[one], row[other] = 1.0, -1.0
    return rows


def _sizes(jacobian: Array, differences: Array) -> Array:
    """Singular values of the readings that no constant image explains, over the prior's root."""
    rest = linalg.null_space(jacobian.sum(axis=1)[None]).T
    sizes: Array = linalg.svdvals(rest @ jacobian @ np.linalg.pinv(np.sqrt(2.0) * differences))
    return sizes


def _exact(jacobian: Array, differences: Array, value: float, readings: Array) -> Array:
    with mp.workdps(_DIGITS):
        columns = [[mp.mpf(one) for one in column] for column in jacobian.T.tolist()]
        ridge2 = mp.mpf(value) ** 2
        penalty = (2 * differences.T @ differences).tolist()  # whole numbers
        system: Any = mp.matrix(len(columns), len(columns))
        for i, one in enumerate(columns):
            for j in range(i + 1):
                system[i, j] = system[j, i] = mp.fdot(one, columns[j]) + ridge2 * mp.mpf(penalty[i][j])
        right = mp.matrix([mp.fdot(one, readings.tolist()) for one in columns])
        return np.array([float(one) for one in mp.cholesky_solve(system, right)])


def _squared() -> Answer:
    prepared("gauss-newton-indenter", usual_problem(), {"hyperparameter": 0.0})
    return Answer(0.0, 0.0)


CASES: Final[tuple[HardCase, ...]] = (
    HardCase(
        "smooth-image-of-a-small-parameter",
        _AREA,
        "λ of a ten thousandth of the largest singular value with the Laplace prior, which leaves a constant free.",
        "the normal equations, solved in fifty digits",
        partial(smooth, 1e-4),
    ),
    HardCase(
        "smooth-image-of-next-to-no-parameter",
        _AREA,
        "λ of a thousand millionth: normal equations of the dual system would have no digit of it.",
        "the normal equations, solved in fifty digits",
        partial(smooth, 1e-9),
    ),
    HardCase(
        "no-regularisation-of-a-squared-system",
        _AREA,
        "λ = 0 with the indenter's prior, which is solved for by normal equations.",
        "a refusal by λ",
        _squared,
        NumericsError,
    ),
)
