"""Total-variation images: piecewise flat, with sharp edges.

Minimises ½‖A x − y‖² + α Σ_k l_k |x_i − x_j| over the edges k between elements i and j, l their length [mm]: the sum
is ∫|∇x| of a piecewise constant image (Rudin, Osher & Fatemi 1992; Borsic, Graham, Adler & Lionheart 2010). By a
primal–dual interior point method: with jumps D x = u − v, u, v ≥ 0, and p the dual of that, the optimum has

    Aᵀ(A x − y) + Dᵀp = 0,  u (α − p) = 0,  v (α + p) = 0,  |p| ≤ α,

and Newton steps with Mehrotra's (1992) predictor and corrector follow u (α − p) = v (α + p) = μ as μ → 0; the
absolute value is not smoothed. Each step solves (AᵀA + DᵀWD) δx = b: DᵀWD is a graph Laplacian, factorised sparsely,
and A has few rows. The duality gap P(x) − D(A x − y) bounds the remaining decrease, and hence ½‖A (x − x*)‖².
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import linalg, sparse
from scipy.sparse.linalg import splu

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array, Indices
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.eit.inverse.priors import neighbour_differences

#: Relative duality gap at which an image is accepted as the minimiser.
TOLERANCE: Final = 1e-5
#: Largest number of steps; fifteen suffice.
MOST_STEPS: Final = 60
_BALANCED = 1e-7  # largest deviation from Aᵀ(Ax − y) + Dᵀp = 0 for a meaningful gap, of Aᵀy
_SHY = 0.99  # of the way to the boundary


@dataclass(frozen=True, slots=True, eq=False)
class TvImage:
    """A minimiser with its accuracy.

    Parameters
    ----------
    image : (e,). residual : ‖A x − y‖².
    gap : duality gap, of the objective.
    """

    image: Array
    residual: float
    gap: float
    steps: int


class TotalVariation:
    """The method prepared for one mesh and one set of readings.

    Parameters
    ----------
    mesh : mesh of the image, e elements.
    rows : (m, e) A, whitened.
    tolerance : duality gap, of the objective.
    most_steps : allowed.
    """

    def __init__(
        self, mesh: Mesh, rows: Array, *, tolerance: float = TOLERANCE, most_steps: int = MOST_STEPS
    ) -> None:
        self._rows = rows
        self._jumps = jump_matrix(mesh)
        self._graph = _Graph.from_jumps(self._jumps)
        self._even = self._graph.laplacian(np.ones(self._jumps.shape[0]))
        self._tolerance = tolerance
        self._most_steps = most_steps

    def image(self, readings: Array, alpha: float) -> TvImage:
        """Minimise for whitened readings (m,) and a positive α.

        NumericsError if squares of readings or rows overflow, or the gap is not closed within the steps allowed.
        """
        with np.errstate(all="ignore"), warnings.catch_warnings():  # non-finite values are refused below
            warnings.simplefilter("ignore", linalg.LinAlgWarning)
            return self._flat_image(readings, alpha) or self._minimise(readings, alpha)

    def flattening(self, readings: Array) -> float:
        """Return an α above which the image of readings is flat; raises as :meth:`image` does."""
        with np.errstate(all="ignore"):
            return self._flattest(readings)[1]

    def _minimise(self, readings: Array, alpha: float) -> TvImage:
        state = _State.beginning(self._rows.shape[1], self._jumps.shape[0], readings, alpha)
        pull, steps = float(np.abs(self._rows.T @ readings).max()), 0
        while True:
            evaluation = _Here.evaluate(state, self._rows, self._jumps, readings)
            gap, imbalance = evaluation.gap(alpha, readings), float(np.abs(evaluation.imbalance).max()) / pull
            if abs(gap) <= self._tolerance and imbalance <= _BALANCED and np.isfinite(state.image).all():
                return TvImage(state.image, float(evaluation.residual @ evaluation.residual), gap, steps)
            if steps == self._most_steps:
                break
            try:
                state = self._step(state, evaluation, alpha)
            except (RuntimeError, ValueError):  # singular to rounding, or no longer finite
                break
            steps += 1
        why = self._why_not_converged(gap, imbalance)
        raise NumericsError(
            f"total variation did not converge: after {steps} of {self._most_steps} steps {why}",
            remedy="raise the hyperparameter, or "
            + (
                "allow more iterations"
                if steps == self._most_steps
                else "check the units of readings and their noise"
            ),
        )

    def _why_not_converged(self, gap: float, apart: float) -> str:
        """Why an image is not accepted as the minimiser; without balance a duality gap is meaningless."""
        if not (np.isfinite(gap) and np.isfinite(apart)):
            return "the image has non-finite values"
        if apart > _BALANCED:
            return f"image and dual are out of balance by {apart:.1e}, at most {_BALANCED:.0e} is needed"
        return f"the duality gap is {gap:.1e} of the objective, at most {self._tolerance:.0e} is needed"

    def _flat_image(self, readings: Array, alpha: float) -> TvImage | None:
        """Minimiser where it is certainly flat: a dual within ±α balances the residual of a constant."""
        level, dual, residual = self._flattest(readings)
        if dual > alpha:
            return None
        return TvImage(np.full(self._rows.shape[1], level), residual, 0.0, 0)

    def _flattest(self, readings: Array) -> tuple[float, float, float]:
        """Best constant image, the largest dual (of least norm) that balances it, and its squared residual."""
        ones = self._rows.sum(axis=1)
        level = float(ones @ readings / (ones @ ones))
        residual = level * ones - readings
        pull = self._rows.T @ residual
        flattest = level, np.inf, float(residual @ residual)
        if np.isfinite(pull).all():
            flattest = level, float(np.abs(self._jumps @ self._even.solve(pull)).max()), flattest[2]
        if not np.isfinite(flattest).all():
            raise NumericsError(
                f"total variation cannot be minimised: readings are up to {np.abs(readings).max():.2g} and"
                f" sensitivities up to {np.abs(self._rows).max():.2g} of their noise: their squares overflow",
                remedy="check the units of readings and of their noise variances",
            )
        return flattest

    def _step(self, state: "_State", here: "_Here", alpha: float) -> "_State":
        weights = 1 / (state.up / (alpha - state.dual) + state.down / (alpha + state.dual))
        newton = _Newton(self._rows, self._jumps, self._graph.laplacian(weights), weights)
        predicted = _direction(newton, state, here, alpha, 0.0, 0.0)
        complementarity = state.complementarity(alpha)
        predicted_complementarity = state.step(predicted, state.room(predicted, alpha)).complementarity(alpha)
        centring = complementarity * (predicted_complementarity / complementarity) ** 3
        corrected = _direction(
            newton,
            state,
            here,
            alpha,
            centring + predicted.up * predicted.dual,
            centring - predicted.down * predicted.dual,
        )
        return state.step(corrected, min(1.0, _SHY * state.room(corrected, alpha)))


def jump_matrix(mesh: Mesh) -> sparse.csr_matrix:
    """Jump over every edge between two elements, times its length [mm]: (edges, e) sparse."""
    joined = mesh.neighbours
    edge = np.sort(mesh.element_edges[joined].reshape(len(joined), 6), axis=1)
    shared = edge[:, :-1][edge[:, 1:] == edge[:, :-1]]
    ends = mesh.nodes_mm[mesh.edges[shared]]
    lengths = np.hypot(*(ends[:, 1] - ends[:, 0]).T)
    jumps = neighbour_differences(mesh)
    jumps.data *= np.repeat(lengths, 2)
    return jumps


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    """Image (e,), jumps up and down (k,) ≥ 0, their dual (k,) in −α … α; also a direction of these."""

    image: Array
    up: Array
    down: Array
    dual: Array

    @classmethod
    def beginning(cls, elements: int, edges: int, readings: Array, alpha: float) -> "_State":
        jump = np.full(edges, float(readings @ readings) / (2 * alpha * edges))
        return cls(np.zeros(elements), jump, jump, np.zeros(edges))

    def step(self, by: "_State", length: float) -> "_State":
        return _State(
            self.image + length * by.image,
            self.up + length * by.up,
            self.down + length * by.down,
            self.dual + length * by.dual,
        )

    def complementarity(self, alpha: float) -> float:
        """μ: the mean of u (α − p) and v (α + p)."""
        return float(self.up @ (alpha - self.dual) + self.down @ (alpha + self.dual)) / (2 * len(self.up))

    def room(self, by: "_State", alpha: float) -> float:
        """Largest step in a direction that keeps everything positive, at most 1."""
        pairs = (
            (self.up, by.up),
            (self.down, by.down),
            (alpha - self.dual, -by.dual),
            (alpha + self.dual, by.dual),
        )
        return min([1.0, *(float((at[d < 0] / -d[d < 0]).min()) for at, d in pairs if (d < 0).any())])


@dataclass(frozen=True, slots=True, eq=False)
class _Here:
    """Residuals at a state: of the readings (m,), the balance (e,) and the jumps (k,); and the jumps D x."""

    residual: Array
    imbalance: Array
    mismatch: Array
    jumps: Array

    @classmethod
    def evaluate(cls, state: _State, rows: Array, jumps: sparse.csr_matrix, readings: Array) -> "_Here":
        residual = rows @ state.image - readings
        jump = jumps @ state.image
        imbalance = rows.T @ residual + jumps.T @ state.dual
        return cls(residual, imbalance, jump - state.up + state.down, jump)

    def gap(self, alpha: float, readings: Array) -> float:
        """Return P − D of P, where D(r) = −½‖r‖² − rᵀy for the residual r that p balances."""
        energy = float(self.residual @ self.residual)
        primal = energy / 2 + alpha * float(np.abs(self.jumps).sum())
        return (primal + energy / 2 + float(self.residual @ readings)) / primal if primal else 0.0


def _direction(
    newton: "_Newton", state: _State, here: _Here, alpha: float, up_wanted: Array | float, down_wanted: Array | float
) -> _State:
    """Newton step towards given products u (α − p) and v (α + p)."""
    upper_slack, lower_slack = alpha - state.dual, alpha + state.dual
    shift = here.mismatch + (down_wanted / lower_slack - state.down) - (up_wanted / upper_slack - state.up)
    image = newton.solve(-here.imbalance - newton.jumps.T @ (newton.weights * shift))
    dual = newton.weights * (newton.jumps @ image + shift)
    return _State(
        image,
        (up_wanted - state.up * upper_slack + state.up * dual) / upper_slack,
        (down_wanted - state.down * lower_slack - state.down * dual) / lower_slack,
        dual,
    )


@dataclass(frozen=True, slots=True)
class _Laplacian:
    """DᵀWD factorised, with one element pinned by a large entry, since constants are in its null space.

    For a right side that sums to zero the solution is the one that is zero there.
    """

    held: float
    solve: Callable[[Array], Array]


@dataclass(frozen=True, slots=True, eq=False)
class _Graph:
    """Positions of the entries of DᵀWD, so that new weights cost only a sum.

    Parameters
    ----------
    rows, starts : of the compressed columns. place : (4 k,) positions of each edge's four entries.
    corner : place of the first element's diagonal entry.
    """

    rows: Indices
    starts: Indices
    place: Indices
    size: Array
    corner: int

    @classmethod
    def from_jumps(cls, jumps: sparse.csr_matrix) -> "_Graph":
        first_node, second_node = jumps.indices.reshape(-1, 2).T.astype(np.int64)
        a, b = jumps.data.reshape(-1, 2).T
        row = np.concatenate([first_node, second_node, first_node, second_node])
        column = np.concatenate([first_node, second_node, second_node, first_node])
        count = jumps.shape[1]
        keys, place = np.unique(column * count + row, return_inverse=True)
        starts = np.searchsorted(keys, np.arange(count + 1) * count)
        size = np.concatenate([a * a, b * b, a * b, a * b])
        return cls(keys % count, starts, place.astype(np.int64), size, int(np.searchsorted(keys, 0)))

    def laplacian(self, weights: Array) -> _Laplacian:
        entries = np.bincount(self.place, self.size * np.tile(weights, 4))
        ground = float(entries.max())
        entries[self.corner] += ground
        count = len(self.starts) - 1
        matrix = sparse.csc_matrix((entries, self.rows, self.starts), shape=(count, count))
        factors = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        return _Laplacian(ground, factors.solve)


class _Newton:
    """(AᵀA + DᵀWD)⁻¹ by a sparse factorisation and a dense system as large as the number of readings."""

    def __init__(self, rows: Array, jumps: sparse.csr_matrix, laplacian: _Laplacian, weights: Array) -> None:
        self.jumps, self.weights, self._rows, self._laplacian = jumps, weights, rows, laplacian
        first = np.zeros((1, rows.shape[1]))
        first[0, 0] = 1
        self._low = np.vstack([rows, first])
        self._back = self._laplacian.solve(np.asfortranarray(self._low.T))
        core = self._low @ self._back
        core.flat[:: len(core) + 1] += np.append(np.ones(len(rows)), -1 / self._laplacian.held)
        self._core = linalg.lu_factor(core)

    def solve(self, right: Array) -> Array:
        estimate = self._solve_once(right)
        residual = right - self._rows.T @ (self._rows @ estimate)
        residual -= self.jumps.T @ (self.weights * (self.jumps @ estimate))
        return estimate + self._solve_once(residual)

    def _solve_once(self, right: Array) -> Array:
        guess = self._laplacian.solve(right)
        return guess - self._back @ linalg.lu_solve(self._core, self._low @ guess)
