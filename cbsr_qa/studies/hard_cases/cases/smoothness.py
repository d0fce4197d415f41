"""Hard cases of smoothness priors: a free constant, and almost no λ."""

from functools import lru_cache
from typing import Any, Final

import numpy as np
from mpmath import mp
from scipy import linalg

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.domain.sensor.patterns import adjacent_pattern
from cbsr_qa.eit.forward.model import ForwardModel
from cbsr_qa.eit.inverse.dual import dual_matrix
from cbsr_qa.eit.inverse.priors import laplace
from cbsr_qa.studies.hard_cases.case import Answer, Area, answer_from_condition
from cbsr_qa.studies.hard_cases.cases.reconstruction import FIFTY, ridge_condition
from cbsr_qa.studies.hard_cases.exact import DIGITS, relative_difference
from cbsr_qa.studies.hard_cases.sheets import RADIUS_MM, make_usual_problem, prepare_method, ring_mesh

AREA: Final = Area("reconstruction")
_SEED: Final = 20261122
#: Sheet with 168 elements, 54 independent readings whose singular values span four decades and a half.
_ELECTRODES, _RINGS = 12, 4


@lru_cache(maxsize=1)
def _sheet() -> tuple[Mesh, Array]:
    """A sheet that fifty digits can be had of, and its Jacobian: of reciprocal readings the one driven first."""
    mesh = ring_mesh(RADIUS_MM * np.arange(1, _RINGS + 1) / _RINGS, 2 * _ELECTRODES, _ELECTRODES, 1)
    ones, contacts = np.ones(len(mesh.elements)), np.full(_ELECTRODES, 5.0)
    model = ForwardModel(mesh, adjacent_pattern(_ELECTRODES), ones, contacts)
    is_used = model.pattern.usable() & np.triu(np.ones(model.pattern.shape, dtype=np.bool_))
    return mesh, model.jacobian()[is_used]


def smooth(relative: float) -> Answer:
    """Image with the Laplace prior against (JᵀJ + λ²R)⁻¹Jᵀy in fifty digits.

    λ is over the largest singular value of JR^−½, without what a constant image explains.
    """
    mesh, jacobian = _sheet()
    differences = _differences(mesh)
    # Singular values of the readings that no constant image explains, over the prior's root.
    null_rows = linalg.null_space(jacobian.sum(axis=1)[None]).T
    sizes = linalg.svdvals(null_rows @ jacobian @ np.linalg.pinv(np.sqrt(2.0) * differences))
    value = relative * float(sizes[0])
    readings = np.random.default_rng(_SEED).standard_normal(len(jacobian))
    computed = dual_matrix(jacobian, laplace(mesh), value) @ readings
    exact = _exact(jacobian, differences, value, readings)
    return answer_from_condition(relative_difference(computed, exact), ridge_condition(sizes, value))


def _differences(mesh: Mesh) -> Array:
    """Rows (edges, e) whose squares the prior adds up, twice."""
    rows = np.zeros((len(mesh.neighbours), len(mesh.elements)))
    for row, (first, second) in zip(rows, mesh.neighbours, strict=True):
        row[first], row[second] = 1.0, -1.0
    return rows


def _exact(jacobian: Array, differences: Array, value: float, readings: Array) -> Array:
    with mp.workdps(DIGITS):
        columns = [[mp.mpf(entry) for entry in column] for column in jacobian.T.tolist()]
        ridge2 = mp.mpf(value) ** 2
        penalty = (2 * differences.T @ differences).tolist()  # whole numbers
        system: Any = mp.matrix(len(columns), len(columns))
        for i, column in enumerate(columns):
            for j in range(i + 1):
                system[i, j] = system[j, i] = mp.fdot(column, columns[j]) + ridge2 * mp.mpf(penalty[i][j])
        right = mp.matrix([mp.fdot(column, readings.tolist()) for column in columns])
        return np.array([float(entry) for entry in mp.cholesky_solve(system, right)])


@AREA.against(FIFTY)
def smooth_image_of_a_small_parameter() -> Answer:
    """λ of a ten thousandth of the largest singular value with the Laplace prior, which leaves a constant free."""
    return smooth(1e-4)


@AREA.against(FIFTY)
def smooth_image_of_next_to_no_parameter() -> Answer:
    """λ of a thousand millionth: normal equations of the dual system would have no digit of it."""
    return smooth(1e-9)


@AREA.refuses(NumericsError, "a refusal by λ")
def no_regularisation_of_a_squared_system() -> None:
    """λ = 0 with the indenter's prior, which is solved for by normal equations."""
    prepare_method("gauss-newton-indenter", make_usual_problem(), {"hyperparameter": 0.0})
