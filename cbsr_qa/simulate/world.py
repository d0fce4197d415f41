"""The simulated world: a sheet, the presses on it, and the effects a scene calls for.

A moment of it depends on its time, its index and the presses so far, on nothing else: any moment can be asked for,
in any order, any number of times.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.loads import Indenter
from cbsr_qa.domain.plan import Scene
from cbsr_qa.domain.scene import Moment, SceneSetting, SimulatedPress
from cbsr_qa.domain.sensor import Material, SensorType
from cbsr_qa.simulate.chain import EffectFactory, build_chain
from cbsr_qa.simulate.sheet import CONTACT_LENGTH_MM, Place, SimulatedSheet

#: Relative conductance changes below this are not solved for. A used reading changes by less than the change itself,
#: in units of the mean reading, even with the head beside a pin: what is left out is three orders below the noise of
#: the quieter shipped material (1.9e-4 in the same units).
NEGLIGIBLE_CHANGE: Final = 1e-7

_TOUCHING: Final = 1e-9  # strain that is more than rounding


@dataclass(frozen=True, slots=True)
class PressTruth:
    """What is true of one press at one time.

    Parameters
    ----------
    index, x_mm, y_mm : which press, and where.
    strain : under the head.
    relative_change : of the conductance under the head.
    stress_kPa : under the head; 0 where it does not touch.
    """

    index: int
    x_mm: float
    y_mm: float
    strain: float
    relative_change: float
    stress_kPa: float


class SimulatedWorld:
    """A sheet and what happens to it.

    Parameters
    ----------
    scene : current, mesh size and effects.
    sensor_type, material, indenter : what is simulated.
    seed : of the run.
    effect_factory : finds an effect's factory by name; see :func:`cbsr_qa.simulate.chain.build_chain`.
    contact_length_mm : see :class:`cbsr_qa.simulate.sheet.SimulatedSheet`.

    Raises
    ------
    ConfigError
        If the scene's effects do not fit together.
    PluginError
        If an effect is not installed.
    """

    def __init__(
        self,
        scene: Scene,
        sensor_type: SensorType,
        material: Material,
        indenter: Indenter,
        *,
        seed: int,
        effect_factory: EffectFactory,
        contact_length_mm: float = CONTACT_LENGTH_MM,
    ) -> None:
        setting = SceneSetting(sensor_type, material, indenter, seed, scene.current_A)
        self.sheet = SimulatedSheet(
            sensor_type,
            size_mm=scene.sheet_mesh_size_mm,
            interelectrode_resistance_ohm=material.interelectrode_resistance_ohm.value,
            contact_length_mm=contact_length_mm,
        )
        used = np.abs(self.sheet.unloaded[sensor_type.pattern.usable()])
        scale_V = float(used.mean()) * scene.current_A if used.size else 0.0
        self.setting = replace(setting, reading_scale_V=scale_V)
        self.chain = build_chain(scene, self.setting, effect_factory)
        self.presses: list[SimulatedPress] = []

    def voltages_V(self, time_s: float, index: int) -> NDArray[np.float64]:
        """Readings of one frame, all taken at one time.

        Parameters
        ----------
        time_s : on the station's clock.
        index : of the frame, the address of its random numbers.

        Returns
        -------
        (drives, measures) float64 [V].

        Raises
        ------
        RefusedError
            If a press lies outside the sheet, or a change leaves an element without conductance.
        """
        moment = self._moment(time_s, index, self.presses)
        self.chain.apply("response", moment)
        changes = _by_place(moment)
        moment.voltages = self.sheet.voltages(changes, self.setting.indenter) * self.setting.current_A
        self.chain.apply("voltages", moment)
        return moment.voltages

    def force_N(self, time_s: float, index: int) -> float:
        """What the load cell reads at a time; the index is the address of the sample's random numbers."""
        touching = [press for press in self.presses if _strain(press, time_s) > _TOUCHING]
        moment = self._moment(time_s, index, touching)
        self.chain.apply("stress", moment)
        pressed_kPa = sum(max(stress, 0.0) for stress in moment.stress_kPa)
        moment.force_N = pressed_kPa * self.setting.indenter.area_mm2 * 1e-3
        self.chain.apply("force", moment)
        return moment.force_N

    def surface_mm(self, x_mm: float, y_mm: float, time_s: float) -> float:
        """How far the sheet's surface lies below nominal at a place [mm]; 0 where no effect says otherwise."""
        moment = self._moment(time_s, 0, [])
        moment.place_mm = (x_mm, y_mm)
        self.chain.apply("geometry", moment)
        return moment.surface_mm

    def truth(self, time_s: float) -> tuple[PressTruth, ...]:
        """Return what is true of every press at a time, before the sheet is measured."""
        moment = self._moment(time_s, 0, self.presses)
        self.chain.apply("response", moment)
        self.chain.apply("stress", moment)
        return tuple(
            _truth(press, time_s, change, stress)
            for press, change, stress in zip(self.presses, moment.response, moment.stress_kPa, strict=True)
        )

    def _moment(self, time_s: float, index: int, presses: list[SimulatedPress]) -> Moment:
        none = [0.0] * len(presses)
        return Moment(self.setting, time_s, index, presses, response=none.copy(), stress_kPa=none)


def _strain(press: SimulatedPress, time_s: float) -> float:
    """Strain under the head; most presses are over, which a run's many force samples find out cheaply."""
    if not press.steps or time_s <= press.steps[0].start_s:
        return 0.0
    last = press.steps[-1]
    if time_s >= last.start_s + last.ramp_s:
        return sum([step.change for step in press.steps])
    return press.strain_at(time_s)


def _by_place(moment: Moment) -> dict[Place, float]:
    """Sum the changes of presses at one place; what has faded away is left out."""
    total: dict[Place, float] = {}
    for press, change in zip(moment.presses, moment.response, strict=True):
        place = (press.x_mm, press.y_mm)
        total[place] = total.get(place, 0.0) + change
    return {place: change for place, change in total.items() if abs(change) > NEGLIGIBLE_CHANGE}


def _truth(press: SimulatedPress, time_s: float, change: float, stress_kPa: float) -> PressTruth:
    strain = press.strain_at(time_s)
    touching = strain > _TOUCHING
    return PressTruth(press.index, press.x_mm, press.y_mm, strain, change, max(stress_kPa, 0.0) if touching else 0.0)
