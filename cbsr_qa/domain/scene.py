"""The simulated world's state at one moment, which effects change in turn."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.loads import Indenter
from cbsr_qa.domain.sensor import Material, SensorType


@dataclass(frozen=True, slots=True)
class StrainStep:
    """A ramp of strain under the head: from ``start_s`` over ``ramp_s`` the strain changes by ``change``."""

    start_s: float
    ramp_s: float
    change: float


@dataclass(slots=True)
class SimulatedPress:
    """One press of the simulated head, growing while it happens.

    Parameters
    ----------
    index : counts every press of the run; random numbers of a press are addressed with it.
    x_mm, y_mm : where.
    steps : strain ramps so far, in time order.
    """

    index: int
    x_mm: float
    y_mm: float
    steps: list[StrainStep] = field(default_factory=list)

    def strain_at(self, time_s: float) -> float:
        """Strain under the head at a time."""
        return sum(s.change * min(max((time_s - s.start_s) / s.ramp_s, 0.0), 1.0) for s in self.steps)


@dataclass(frozen=True, slots=True)
class SceneSetting:
    """What does not change through a scene.

    Parameters
    ----------
    sensor_type, material, indenter : what is simulated.
    seed : of the run; random numbers are addressed with it.
    current_A : drive current.
    reading_scale_V : mean magnitude of the used readings of the unloaded sheet [V], for effects that are stated
        relative to it.
    """

    sensor_type: SensorType
    material: Material
    indenter: Indenter
    seed: int
    current_A: float
    reading_scale_V: float = 0.0


@dataclass(slots=True, eq=False)
class Moment:
    """One moment of the simulated world. Effects change it in the scene's declared order.

    Parameters
    ----------
    setting : the constants of the scene.
    time_s : on the station's clock.
    index : of the frame, or of the force sample, 0 for the geometry; random numbers are addressed with it.
    presses : all so far, also those released whose residue may linger.
    response : relative conductance change under the head, per press.
    stress_kPa : under the head, per press.
    voltages : (drives, measures) [V]; None until the sheet was solved.
    force_N : what the load cell reads.
    place_mm : where the head is, from the sheet's centre.
    surface_mm : how far the sheet's surface there lies below nominal.
    """

    setting: SceneSetting
    time_s: float
    index: int
    presses: list[SimulatedPress]
    response: list[float]
    stress_kPa: list[float]
    voltages: NDArray[np.float64] | None = None
    force_N: float = 0.0
    place_mm: tuple[float, float] = (0.0, 0.0)
    surface_mm: float = 0.0
