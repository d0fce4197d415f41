"""The simulated world: a sheet, the presses on it, and the effects of a scene.

A moment depends only on its time, its index and the presses so far, so that moments can be computed in any order and
repeatedly.
"""

import math
from typing import Final

import numpy as np

from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.plan import Scene
from cbsr_qa.domain.plan.world import (
    CONTACT_LENGTH_MM,
    HeadPosition,
    Moment,
    SceneSetting,
    SheetDesign,
    SimulatedPress,
    Transcript,
)
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.domain.sensor.sensor_type import Material, SensorType
from cbsr_qa.simulate.chain import EffectFactory, build_chain
from cbsr_qa.simulate.frames import FrameMaker, SimulatedFrame, SimulatedRing
from cbsr_qa.simulate.sheet import SimulatedSheet, finest_mesh_mm

_TOUCHING: Final = 1e-9  # larger strains are not rounding


class SimulatedWorld:
    """A sheet with its presses and effects; or a resistor ring in its place, if the scene has one.

    ConfigError if the scene's effects do not fit together; PluginError if an effect is not installed.

    Parameters
    ----------
    effect_factory : finds an effect's factory by name; see :func:`cbsr_qa.simulate.chain.build_chain`.
    contact_length_mm : contact impedance over sheet resistance, unless an effect changes it.
    began_s : start of the station's clock on the run's time line, see ``SceneSetting``.
    sheet : reused from a scene with the same effects on the sheet; by default it is created.
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
        began_s: float = 0.0,
        sheet: SimulatedSheet | None = None,
    ) -> None:
        self.setting = SceneSetting(
            sensor_type, material, indenter, seed, scene.current_A, scene.frame_period_s, began_s
        )
        self.chain = build_chain(scene, self.setting, effect_factory)
        self.sheet = self._make_sheet(scene, contact_length_mm) if sheet is None else sheet
        # Noise is the station's, in volts: noise stated relative to the sheet's readings is the same for a ring.
        # Mean magnitude of the used readings per ampere; of all of them on a strip with two pins.
        usable = sensor_type.pattern.usable()
        mean_reading_ohm = float(np.abs(self.sheet.unloaded[usable] if usable.any() else self.sheet.unloaded).mean())
        self._scale_V = mean_reading_ohm * scene.current_A
        ring = scene.reference_ring_ohm
        self._connected = SimulatedRing(self.sheet.design, ring) if ring else self.sheet
        self._frames = FrameMaker(self._connected, self.chain)
        self.presses: list[SimulatedPress] = []
        self._moving = _Moving()
        self._memory_s = self.chain.memory_s
        self._frame_reach_s = 2 * scene.frame_period_s  # beside a board's pauses

    def _make_sheet(self, scene: Scene, contact_length_mm: float) -> SimulatedSheet:
        finest_mm = finest_mesh_mm(self.setting.sensor_type)
        if scene.sheet_mesh_size_mm < finest_mm:
            raise ConfigError(
                f"scene {scene.name!r}: sheet_mesh_size_mm is {scene.sheet_mesh_size_mm:g}",
                remedy=f"it must be at least {finest_mm:g} on this sheet",
            )
        design = SheetDesign.make_uniform(self.setting.sensor_type, self.setting.indenter, contact_length_mm)
        self.chain.design(design)
        return SimulatedSheet(
            design,
            size_mm=scene.sheet_mesh_size_mm,
            interelectrode_resistance_ohm=self.setting.material.interelectrode_resistance_ohm.value,
        )

    def frame(self, time_s: float, index: int, pauses_s: Array | None = None) -> SimulatedFrame:
        """Take one frame.

        RefusedError if a press lies outside the sheet, or a change leaves an element without conductance.
        ``pauses_s``: (drives,) delay of each row, if readings are not simultaneous.
        """
        reach_s = self._frame_reach_s + (float(np.abs(pauses_s).max()) if pauses_s is not None else 0.0)
        felt = [press for press in self.presses if self._is_felt(press, time_s, reach_s)]
        return self._frames.frame(lambda at_s: self._moment(at_s, index, felt), time_s, pauses_s)

    def transcript(self, time_s: Array) -> Transcript:
        """Transcript of frames at these times (frames,) [s]: losses, and pauses of a board."""
        transcript = Transcript.complete(self.setting, time_s)
        self.chain.record(transcript)
        return transcript

    def voltages_V(self, time_s: float, index: int) -> Array:
        """Readings of one frame, (drives, measures) [V]; parameters and errors as for :meth:`frame`."""
        return self.frame(time_s, index).voltages

    def force_N(self, time_s: float, index: int) -> float:
        """Load cell reading at a time; the index addresses the sample's random numbers."""
        touching = [
            press
            for press in self._moving.select_presses(self.presses, time_s)
            if press.strain_at(time_s) > _TOUCHING
        ]
        moment = self._moment(time_s, index, touching)
        if touching:  # most samples are of a head in the air
            self.chain.apply("stress", moment)
            moment.force_N = 1e-3 * sum(
                max(stress, 0.0) * self._connected.area_under_head_mm2((press.x_mm, press.y_mm))
                for press, stress in zip(touching, moment.stress_kPa, strict=True)
            )
        self.chain.apply("force", moment)
        return moment.force_N

    def surface_mm(self, x_mm: float, y_mm: float, time_s: float) -> float:
        """Depth of the sheet's surface below nominal at a place [mm]; 0 without an effect on it."""
        moment = self._moment(time_s, 0, [])
        moment.place_mm = (x_mm, y_mm)
        self.chain.apply("geometry", moment)
        return moment.surface_mm

    def thickness_mm(self, x_mm: float, y_mm: float) -> float:
        """Thickness of the sheet at a place [mm]."""
        return float(self.sheet.design.thickness_mm_at(np.array([[x_mm, y_mm]]))[0])

    def head_at(self, to: HeadPosition, before: HeadPosition, time_s: float, index: int) -> HeadPosition:
        """Place that the head reaches for a commanded place; the index counts its movements."""
        moment = self._moment(time_s, index, [])
        moment.place_mm, moment.from_mm = (to[0], to[1]), (before[0], before[1])
        moment.depth_mm, moment.from_depth_mm = to[2], before[2]
        self.chain.apply("position", moment)
        return (*moment.place_mm, moment.depth_mm)

    def _is_felt(self, press: SimulatedPress, time_s: float, reach_s: float) -> bool:
        """Whether a press can affect a frame around a time: it has begun, and has not faded."""
        if not press.steps or press.steps[0].start_s > time_s + reach_s:
            return False
        lifted = time_s - reach_s - press.end_s
        return lifted <= self._memory_s or press.strain_at(press.end_s) > _TOUCHING

    def _moment(self, time_s: float, index: int, presses: list[SimulatedPress]) -> Moment:
        none = [0.0] * len(presses)
        return Moment(
            self.setting, time_s, index, presses, response=none.copy(), stress_kPa=none, reading_scale_V=self._scale_V
        )


class _Moving:
    """Index of current presses: most samples of a run see one press or none, the one before saw."""

    def __init__(self) -> None:
        self._count = 0
        self._last: SimulatedPress | None = None
        self._from_s: Array = np.zeros(0)
        self._to_s: Array = np.zeros(0)
        self._found: list[SimulatedPress] = []
        self._since_s, self._until_s = math.inf, -math.inf

    def select_presses(self, presses: list[SimulatedPress], time_s: float) -> list[SimulatedPress]:
        """Return the presses that may act at a time."""
        last_press = presses[-1] if presses else None
        if len(presses) != self._count or last_press is not self._last:
            # A press not yet lifted may continue; it is checked again when the next one comes.
            is_lifted = [press.strain_at(press.end_s) <= _TOUCHING for press in presses]
            self._from_s = np.array([p.steps[0].start_s if p.steps else -np.inf for p in presses])
            self._to_s = np.array([p.end_s if up else np.inf for p, up in zip(presses, is_lifted, strict=True)])
            self._to_s[-1:] = np.inf
            self._count, self._last = len(presses), last_press
            self._since_s, self._until_s = math.inf, -math.inf
        if not self._since_s < time_s < self._until_s:
            self._find(presses, time_s)
        return self._found

    def _find(self, presses: list[SimulatedPress], time_s: float) -> None:
        """Find the presses at a time, and the times between which they are the same."""
        ends = np.concatenate([self._from_s, self._to_s])
        self._since_s = float(ends[ends <= time_s].max(initial=-np.inf))
        self._until_s = float(ends[ends >= time_s].min(initial=np.inf))
        active = np.flatnonzero((self._from_s <= time_s) & (time_s <= self._to_s))
        self._found = [presses[k] for k in active.tolist()]
