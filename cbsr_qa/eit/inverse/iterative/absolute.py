"""Iterative Gauss–Newton for absolute conductance and contact impedances.

Minimises Φ(θ) = Σ (V(θ) − d)²/σ² + (θ − θ₀)ᵀC⁻¹(θ − θ₀), θ the logarithms of conductance and contact impedance, σ the
noise, C the prior covariance: the most probable state (Tarantola 2005, section 3.2; Vilhunen et al. 2002, Heikkinen
et al. 2002). Each step is solved in its dual form, as large as the number of readings,

    θ⁺ = θ₀ + C Jᵀ (J C Jᵀ + σ²)⁻¹ (d − V(θ) + J (θ − θ₀)),

and halved until Φ falls. C is never inverted: with θ = θ₀ + C w the second term is wᵀ(θ − θ₀). The conductance of an
element of the forward mesh is the mean over it of the image's.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import linalg, sparse
from scipy.spatial.distance import cdist

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.imaging import ImagingProblem
from cbsr_qa.domain.numbers import Array, Indices
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.eit.forward.model import ForwardModel
from cbsr_qa.eit.forward.value_range import ValueRangeError
from cbsr_qa.eit.inverse.overlap import overlap_fractions
from cbsr_qa.eit.inverse.problem import NOMINAL_CONTACT_MM, make_uniform_model
from cbsr_qa.eit.inverse.readings import ReadingFold

#: Largest number of steps; three to six suffice.
MOST_STEPS: Final = 20
#: Remaining decrease of Φ at convergence: a hundredth of a standard deviation, or a millionth of Φ.
TOLERANCE: Final = 1e-4
_SHARE: Final = 1e-6
_MOST_ELEMENTS: Final = 10_000
_LONGEST: Final = 1.5  # change of a logarithm in one step
_HALVINGS: Final = 8
_LEAST_FALL: Final = 1e-4  # of the predicted one (Armijo)


@dataclass(frozen=True, slots=True, eq=False)
class SheetState:
    """Conductance and contacts of a sheet, in units in which the nominal sheet's conductance is one.

    Parameters
    ----------
    log_conductance : (e,) ln γ. log_contact : (electrodes,) ln z, z in mm.
    """

    log_conductance: Array
    log_contact: Array

    @property
    def unknowns(self) -> Array:
        """All unknowns, (e + electrodes,)."""
        return np.concatenate([self.log_conductance, self.log_contact])

    def step(self, by: Array) -> "SheetState":
        """Return the state a step (e + electrodes,) further."""
        count = len(self.log_conductance)
        return SheetState(self.log_conductance + by[:count], self.log_contact + by[count:])


class SheetModel:
    """Folded readings of a problem as a function of the sheet's state.

    ``mesh_size``: edge length of the forward mesh (second order), of the sheet's radius.
    """

    def __init__(self, problem: ImagingProblem, mesh_size: float) -> None:
        sensor = problem.sensor_type
        self.fold = ReadingFold.from_problem(problem)
        self._even = make_uniform_model(sensor, mesh_size)
        self._share: sparse.csr_matrix = overlap_fractions(self._even.mesh, problem.mesh)
        drive, measure = np.argwhere(problem.used)[self.fold.first].T
        self._drive, self._measure = drive.astype(np.int64), measure.astype(np.int64)
        self.nominal = SheetState(
            np.zeros(len(problem.mesh.elements)), np.full(sensor.electrodes.count, np.log(NOMINAL_CONTACT_MM))
        )

    def solve(self, state: SheetState) -> "SolvedSheet":
        conductance = self._share @ np.exp(state.log_conductance)
        model = self._even.with_values(conductance=conductance, contact_impedance=np.exp(state.log_contact))
        return SolvedSheet(state, model, self._share, self._drive, self._measure)


@dataclass(frozen=True, slots=True, eq=False)
class SolvedSheet:
    """One state of a sheet, factorised."""

    state: SheetState
    model: ForwardModel
    share: sparse.csr_matrix
    drive: Indices
    measure: Indices

    def readings(self) -> Array:
        """Folded readings (g,) at unit current [V/A]."""
        return self.model.voltages()[self.drive, self.measure]

    def jacobian(self) -> Array:
        """Change of the readings per change of ln γ and ln z, (g, e + electrodes)."""
        conductance_rows = self.model.jacobian_rows(self.drive, self.measure) @ self.share
        contacts = self.model.contact_jacobian()[self.drive, self.measure]
        return np.hstack(
            [conductance_rows * np.exp(self.state.log_conductance), contacts * np.exp(self.state.log_contact)]
        )


@dataclass(frozen=True, slots=True, eq=False)
class SheetPrior:
    """Prior of a state: the covariance C of its logarithms.

    Parameters
    ----------
    conductance : (e, e). contact : variance of each ln z.
    """

    conductance: Array
    contact: float

    @classmethod
    def from_mesh(cls, mesh: Mesh, *, spread: float, length_mm: float, level: float, contact: float) -> "SheetPrior":
        """Matérn covariance of smoothness 3/2, and a level common to all elements; raises as :func:`matern`.

        Parameters
        ----------
        spread : standard deviation of ln γ about the level. length_mm : over which it varies.
        level : standard deviation of the level. contact : of each ln z.
        """
        return cls(spread**2 * matern(mesh, length_mm) + level**2, contact**2)

    def times(self, columns: Array) -> Array:
        """C times columns (e + electrodes, k)."""
        count = len(self.conductance)
        return np.concatenate([self.conductance @ columns[:count], self.contact * columns[count:]])


@dataclass(frozen=True, slots=True, eq=False)
class FoundState:
    """The most probable state, and how well it is known.

    Parameters
    ----------
    solved : the state with its readings.
    residual : Σ (V − d)²/σ² over the number of readings; one if only noise remains.
    unexplained : ‖V − d‖/‖d‖.
    log_contact_error : (electrodes,) standard deviations of ln z.
    """

    solved: SolvedSheet
    residual: float
    unexplained: float
    log_contact_error: Array
    steps: int

    @property
    def conductance(self) -> Array:
        """γ (e,) in units of the nominal sheet's."""
        return np.exp(self.solved.state.log_conductance)

    @property
    def contact_impedance(self) -> Array:
        """Contact impedance z (electrodes,) times the nominal sheet's conductance [mm]."""
        return np.exp(self.solved.state.log_contact)


def matern(mesh: Mesh, length_mm: float) -> Array:
    """Matérn correlation of smoothness 3/2 between elements, (e, e); NumericsError if there are too many."""
    if len(mesh.elements) > _MOST_ELEMENTS:
        raise NumericsError(
            f"absolute images use a dense covariance: {len(mesh.elements)} elements; at most {_MOST_ELEMENTS}",
            remedy="use larger image elements",
        )
    distance = cdist(mesh.centroids_mm, mesh.centroids_mm) * (np.sqrt(3) / length_mm)
    correlation: Array = (1 + distance) * np.exp(-distance)
    return correlation


class Linearised:
    """A state with its Jacobian, and the dual system of a step from it, for the prior C and (g,) σ².

    NumericsError if rounding dominates the system, as the noise variances are too small compared with the prior.
    """

    def __init__(self, solved: SolvedSheet, prior: SheetPrior, variance: Array) -> None:
        self.solved, self.variance = solved, variance
        self.readings = solved.readings()
        self.jacobian = solved.jacobian()
        self.back = prior.times(self.jacobian.T)
        self._prior = prior
        system = self.jacobian @ self.back
        system.flat[:: len(system) + 1] += variance
        try:
            self._factor = linalg.cho_factor(system, lower=True)
        except (linalg.LinAlgError, ValueError) as error:  # not positive to rounding, or not finite
            raise _explain_divergence(
                f"noise variances of {variance.min():.2g} to {variance.max():.2g} leave"
            ) from error

    def matrix(self) -> Array:
        """First step from here per change of the readings, (e + electrodes, g)."""
        return linalg.cho_solve(self._factor, self.back.T).T

    def step(self, wanted: Array, place: "_Place") -> tuple[Array, Array, float]:
        """Step of θ and of w towards readings, and the fall of Φ it promises."""
        residual = wanted - self.readings + self.jacobian @ place.away
        coefficients = linalg.cho_solve(self._factor, residual)
        step = self.back @ coefficients - place.away
        weights = self.jacobian.T @ coefficients - place.weights
        reading_step = self.jacobian @ step
        return step, weights, float(reading_step @ (reading_step / self.variance) + weights @ step)

    def contact_error(self) -> Array:
        """Standard deviations of ln z after the readings are known, (electrodes,)."""
        count = len(self.solved.state.log_conductance)
        back = self.back[count:]
        explained = np.einsum("ng,gn->n", back, linalg.cho_solve(self._factor, back.T))
        error: Array = np.sqrt(np.maximum(self._prior.contact - explained, 0))
        return error


@dataclass(frozen=True, slots=True, eq=False)
class _Place:
    """Current point of an iteration: θ − θ₀ and w, with θ − θ₀ = C w."""

    away: Array
    weights: Array

    def step(self, step: Array, weights: Array, length: float) -> "_Place":
        return _Place(self.away + length * step, self.weights + length * weights)

    def cost(self) -> float:
        return float(self.weights @ self.away)


def most_probable_state(
    model: SheetModel, start: Linearised, wanted: Array, prior: SheetPrior, *, most_steps: int = MOST_STEPS
) -> FoundState:
    """Iterate from the expected state θ₀ to the most probable state, for (g,) folded readings d.

    NumericsError if no step lowers Φ, or steps run out, before it is within ``TOLERANCE``; or if Φ is not finite.
    """
    origin, linearised, variance = start.solved.state, start, start.variance
    place = _Place(np.zeros(len(origin.unknowns)), np.zeros(len(origin.unknowns)))
    cost = _misfit(linearised.readings, wanted, variance)
    fall = np.inf
    for number in range(most_steps):
        with np.errstate(all="ignore"):  # non-finite values are refused here
            step, weights, fall = linearised.step(wanted, place)
        if not (np.isfinite(cost) and np.isfinite(fall) and np.isfinite(step).all()):
            raise _explain_divergence(f"readings of up to {np.abs(wanted).max():.2g} give")
        if fall <= TOLERANCE + _SHARE * cost:
            return _describe_state(linearised, wanted, number)
        length = min(1.0, _LONGEST / float(np.abs(step).max()))
        for _ in range(_HALVINGS):
            trial_place = place.step(step, weights, length)
            try:
                solved = model.solve(origin.step(trial_place.away))
            except ValueRangeError:  # states this far out have no readings
                trial_cost = np.inf
            else:
                trial_cost = _misfit(solved.readings(), wanted, variance) + trial_place.cost()
            if trial_cost <= cost - _LEAST_FALL * length * fall:
                break
            length /= 2
        else:
            raise _refuse_unconverged(number + 1, fall, "no step lowers the misfit")
        place, cost, linearised = trial_place, trial_cost, Linearised(solved, prior, variance)
    raise _refuse_unconverged(most_steps, fall, "steps ran out")


def _misfit(readings: Array, wanted: Array, variance: Array) -> float:
    with np.errstate(over="ignore"):
        return float(((readings - wanted) ** 2 / variance).sum())


def _describe_state(here: Linearised, wanted: Array, steps: int) -> FoundState:
    residual = here.readings - wanted
    return FoundState(
        here.solved,
        _misfit(here.readings, wanted, here.variance) / len(wanted),
        float(np.linalg.norm(residual) / np.linalg.norm(wanted)),
        here.contact_error(),
        steps,
    )


def _explain_divergence(what: str) -> NumericsError:
    return NumericsError(
        f"the absolute image cannot be computed: {what} no finite numbers, or none that rounding does not decide",
        remedy="check the units of readings and of their noise variances, and noise_dB",
    )


def _refuse_unconverged(steps: int, fall: float, why: str) -> NumericsError:
    return NumericsError(
        f"the absolute image did not converge: after {steps} steps {why}, and the misfit would still fall by"
        f" {fall:.2g} (χ²)",
        remedy="check the geometry and the electrodes' order, state a larger noise (noise_dB), or allow more"
        " iterations",
    )
