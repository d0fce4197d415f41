"""Reconstructions and metrics."""

from typing import Protocol, runtime_checkable

from cbsr_qa.domain.measurement import Measurement
from cbsr_qa.domain.observation import LoadObservation, RunObservation
from cbsr_qa.domain.reconstruction import ImagingProblem, PreparedReconstruction


class Reconstruction(Protocol):
    """Turns a linearised problem into images; a linear method into one matrix (LinearReconstruction).

    A reconstruction may say by two attributes what ``analyse``, which images single presses, must hand it beyond
    their changes: ``sequences = True`` where a frame's image depends on the frames beside it, for consecutive
    frames; ``absolute = True`` where it wants the unloaded sensor's own readings (:attr:`ImagingProblem.measured`),
    with changes in the same one scale. ``weighs_noise = False`` where it lets all readings count alike whatever
    :attr:`ImagingProblem.noise_variance` says: a recipe that asks for weights is then refused.
    """

    def prepare(self, problem: ImagingProblem) -> PreparedReconstruction:
        """Prepare once per sensor type; NumericsError where the problem cannot be solved."""
        ...


@runtime_checkable
class LoadMetric(Protocol):
    """A metric of one press.

    A metric of either kind may have an attribute ``measures``, a mapping from the names of its measurements to
    their units. Limits are then checked against it before anything moves; without it, only after the run.
    """

    def measure_load(self, load: LoadObservation, run: RunObservation) -> tuple[Measurement, ...]:
        """Measure; a quantity that cannot be determined is a Measurement without value, never an exception."""
        ...


@runtime_checkable
class RunMetric(Protocol):
    """A metric of a whole run. A metric plugin may be both."""

    def measure_run(self, run: RunObservation) -> tuple[Measurement, ...]:
        """Measure; a quantity that cannot be determined is a Measurement without value, never an exception."""
        ...
