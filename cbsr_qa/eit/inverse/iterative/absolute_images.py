"""Absolute images of a sensor: the unloaded state first, then every frame relative to it."""

from dataclasses import dataclass

import numpy as np

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.imaging import ImagingProblem, ParameterChoice, check_readings
from cbsr_qa.domain.numbers import Array
from cbsr_qa.eit.inverse.iterative.absolute import (
    FoundState,
    Linearised,
    SheetModel,
    SheetPrior,
    matern,
    most_probable_state,
)
from cbsr_qa.eit.inverse.noise_figures import central_signal, noise_figure
from cbsr_qa.eit.inverse.one_step import RidgeSearch
from cbsr_qa.eit.inverse.priors import Prior

_UNEXPLAINED = 0.1  # of a frame's readings; more indicates another sheet, or electrodes in another order
_KNOWN = 0.5  # of its expected spread: a contact with a larger error is undetermined


@dataclass(frozen=True, slots=True)
class Expected:
    """Prior expectations of a sensor; all numbers are positive.

    Parameters
    ----------
    noise_dB : noise of readings below the mean reading.
    spread, length : standard deviation of ln γ over the unloaded sheet, and its correlation length, of the radius.
    load_spread, load_length : the same of changes under load. None: the spread whose first step has
        ``noise_figure`` on the sensor type's nominal problem.
    contact_spread : standard deviation of ln z about the nominal contact.
    mesh_size : edge length of the forward mesh (second order), of the radius.
    iterations : Gauss–Newton steps allowed.
    """

    noise_dB: float
    spread: float
    length: float
    load_spread: float | None
    noise_figure: float
    load_length: float
    contact_spread: float
    mesh_size: float
    iterations: int

    def deviation(self, problem: ImagingProblem) -> float:
        """σ of a reading of unit relative variance; the mean reading is that of the sensor type's nominal problem."""
        reference = (problem.nominal or problem).reference
        return float(10 ** (-self.noise_dB / 20) * np.abs(reference).mean())

    def choose_spread(self, problem: ImagingProblem) -> tuple[float, str]:
        """Spread of loads, and how it was chosen: σ/λ of a one-step image."""
        if self.load_spread is not None:
            return self.load_spread, "load_spread given"
        nominal = problem.nominal or problem
        correlation = matern(nominal.mesh, self.load_length * problem.sensor_type.radius_mm)
        search = RidgeSearch(nominal, Prior(lambda columns: correlation @ columns))
        spread = self.deviation(nominal) / search.for_noise_figure(self.noise_figure)
        return spread, f"the first step has noise figure {self.noise_figure:.2f} on the nominal model"


@dataclass(frozen=True, slots=True, eq=False)
class AbsoluteImages:
    """A prepared method, see :class:`~cbsr_qa.domain.imaging.PreparedReconstruction`.

    Parameters
    ----------
    choice : choice of the spread of loads, which regularises together with the noise.
    reference : the unloaded sheet's state; nominal if its readings are unknown.
    scale : ratio of the readings to those of a sheet of this state.
    before_load : the reference, linearised, with the prior ``load``.
    """

    method: str
    problem: ImagingProblem
    choice: ParameterChoice
    expected: Expected
    model: SheetModel
    reference: FoundState
    scale: float
    before_load: Linearised
    load: SheetPrior

    @classmethod
    def find(cls, method: str, problem: ImagingProblem, expected: Expected) -> "AbsoluteImages":
        """Find the reference's state and linearise there.

        NumericsError if the reference readings fit no such sheet, or the iteration does not converge.
        """
        model = SheetModel(problem, expected.mesh_size)
        variance = expected.deviation(problem) ** 2 * model.fold.variance
        reference, scale = _reference_state(problem, expected, model, variance)
        spread, description = expected.choose_spread(problem)
        length_mm = expected.load_length * problem.sensor_type.radius_mm
        # A contact changes as little as conductance does; otherwise it would explain too much.
        load_prior = SheetPrior.from_mesh(problem.mesh, spread=spread, length_mm=length_mm, level=0.0, contact=spread)
        linearised = Linearised(reference.solved, load_prior, variance)
        # The first step is a matrix: its noise figure is that of the method.
        matrix = model.fold.unfold(linearised.matrix()[: len(problem.mesh.elements)])
        areas_mm2, signal = problem.mesh.areas_mm2, central_signal(problem)
        figure = noise_figure(matrix, signal, areas_mm2, noise_variance=problem.noise_variance)
        description = f"{description}; {_describe_reference(problem, reference)}"
        criterion = "noise-figure" if expected.load_spread is None else "given"
        choice = ParameterChoice(spread, description, figure, "spread of ln γ under loads", criterion=criterion)
        return cls(method, problem, choice, expected, model, reference, scale, linearised, load_prior)

    def images(self, changes: Array) -> Array:
        """Relative conductance changes (n, e) against the reference's state, of scaled changes (n, m).

        Raises
        ------
        RefusedError
            If readings do not fit or are not finite.
        NumericsError
            If a frame does not converge (with the number of steps), or no sheet explains its readings to 10 %.
        """
        unloaded = self.reference.conductance
        images = np.array([state.conductance / unloaded - 1 for state in self.states(changes)])
        return images.reshape(len(changes), len(unloaded))

    def absolute(self, changes: Array) -> Array:
        """Conductances (n, e) in units of the unit model's, from the same changes."""
        return (1 + self.images(changes)) * self.reference.conductance / self.scale

    def states(self, changes: Array) -> list[FoundState]:
        """State of each frame, with contacts estimated again; raises as :meth:`images` does."""
        folded = self.model.fold.fold(check_readings(changes, self.problem)) / self.scale
        solved = [
            most_probable_state(
                self.model,
                self.before_load,
                self.before_load.readings + change,
                self.load,
                most_steps=self.expected.iterations,
            )
            for change in folded
        ]
        for number, state in enumerate(solved):
            _check_explained(state, f"frame {number}")
        return solved

    def contact_impedance(self) -> Array:
        """Contact impedances of the unloaded sensor times the unit model's conductance, (electrodes,) [mm].

        NumericsError names the electrodes whose contact the readings do not determine.
        """
        error = self.reference.log_contact_error
        unknown = np.flatnonzero(error > _KNOWN * self.expected.contact_spread)
        if unknown.size or self.problem.measured is None:
            electrodes = ", ".join(str(number) for number in unknown) or "all"
            raise NumericsError(
                f"the readings do not determine the contact impedance of electrodes {electrodes}",
                remedy="include reference readings at driven electrodes",
            )
        return self.reference.contact_impedance * self.scale


def _reference_state(
    problem: ImagingProblem, expected: Expected, model: SheetModel, variance: Array
) -> tuple[FoundState, float]:
    """State of the unloaded sheet, and the scale of its readings."""
    prior = SheetPrior.from_mesh(
        problem.mesh,
        spread=expected.spread,
        length_mm=expected.length * problem.sensor_type.radius_mm,
        level=1.0,
        contact=expected.contact_spread,
    )
    nominal = Linearised(model.solve(model.nominal), prior, variance)
    if problem.measured is None:
        state = most_probable_state(model, nominal, nominal.readings, prior)
        return state, 1.0
    measured = model.fold.fold(check_readings(problem.measured[None], problem))[0]
    scale = float(measured @ nominal.readings / (nominal.readings @ nominal.readings))
    if not scale > 0:
        raise NumericsError(
            "the reference readings are uncorrelated with the model's, or have the opposite polarity",
            remedy="check the electrode numbering of the sensor type and that the source was on",
        )
    state = most_probable_state(model, nominal, measured / scale, prior, most_steps=expected.iterations)
    _check_explained(state, "the reference")
    return state, scale


def _check_explained(state: FoundState, what: str) -> None:
    if state.unexplained > _UNEXPLAINED:
        raise NumericsError(
            f"no sheet of this geometry explains {what}: {state.unexplained:.0%} of the readings remains unexplained,"
            f" {_UNEXPLAINED:.0%} is allowed",
            remedy="check geometry, electrode numbering and pattern of the sensor type, and mask bad channels",
        )


def _describe_reference(problem: ImagingProblem, reference: FoundState) -> str:
    if problem.measured is None:
        return "the reference is the nominal sheet: its readings are unknown"
    return (
        f"the reference's state, found in {reference.steps} steps, leaves {reference.unexplained:.2%} of its readings"
    )
