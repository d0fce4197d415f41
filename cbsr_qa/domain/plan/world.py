"""State that the effects of a scene modify: the sheet's design, and the world at one moment."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.domain.sensor.sensor_type import Material, SensorType

#: A factor by place: (n, 2) [mm] to (n,), above zero.
SheetField = Callable[[Array], Array]

#: (x, y, depth below the nominal surface) of the head [mm]; hovering is a negative depth.
HeadPosition = tuple[float, float, float]

#: Contact impedance over sheet resistance z γ₀ [mm]. Chosen by us, since the paper gives no contact impedance: about
#: a tenth of the inter-electrode resistance then lies in the contacts of 0.65 mm pins.
CONTACT_LENGTH_MM = 0.2


@dataclass(frozen=True, slots=True)
class StrainRamp:
    """A ramp of strain under the head: from ``start_s`` over ``ramp_s`` the strain changes by ``change``."""

    start_s: float
    ramp_s: float
    change: float


@dataclass(slots=True)
class SimulatedPress:
    """One press of the simulated head, growing while it happens.

    Parameters
    ----------
    index : number of the press in the run; random numbers of a press are addressed with it.
    x_mm, y_mm : place of the press [mm].
    steps : strain ramps so far, in time order.
    """

    index: int
    x_mm: float
    y_mm: float
    steps: list[StrainRamp] = field(default_factory=list)

    @property
    def end_s(self) -> float:
        return self.steps[-1].start_s + self.steps[-1].ramp_s if self.steps else -math.inf

    def strain_at(self, time_s: float) -> float:
        if not self.steps or time_s <= self.steps[0].start_s:
            return 0.0
        if time_s >= self.end_s:  # true of most presses of a run
            return sum([step.change for step in self.steps])
        return sum(s.change * min(max((time_s - s.start_s) / s.ramp_s, 0.0), 1.0) for s in self.steps)


@dataclass(frozen=True, slots=True)
class SceneSetting:
    """Constants of a scene.

    Parameters
    ----------
    seed : seed of the run; random numbers are addressed with it.
    frame_period_s : time of one frame.
    began_s : time on the run's time line when the station's clock began [s]; above 0 in a resumed session.
    """

    sensor_type: SensorType
    material: Material
    indenter: Indenter
    seed: int
    current_A: float
    frame_period_s: float = 2.5
    began_s: float = 0.0


@dataclass(frozen=True, slots=True)
class HeadRing:
    """One of the nested outlines that make up a head's pressure.

    Parameters
    ----------
    size : size of the head's outline about its centre, 1 for the head itself.
    weight : relative pressure under it, which adds to that of the other rings.
    """

    size: float
    weight: float


@dataclass(slots=True, eq=False)
class SheetDesign:
    """Design of a sheet. Effects of the stage ``sheet`` modify it, once.

    Parameters
    ----------
    sensor_type, indenter : type of the sensor, and the head that presses on it.
    contact_mm : (electrodes,) contact impedance over the sheet's mean resistance [mm].
    shift_mm : (electrodes, 2) displacement of each electrode from its nominal place.
    conductance, response, thickness : factors by place, each 1 on average; several multiply. Conductance is that of
        the material: the sheet's is thicker where the sheet is.
    rings : the head's pressure; the weighted areas add up to the head's.
    """

    sensor_type: SensorType
    indenter: Indenter
    contact_mm: Array
    shift_mm: Array
    conductance: list[SheetField] = field(default_factory=list)
    response: list[SheetField] = field(default_factory=list)
    thickness: list[SheetField] = field(default_factory=list)
    rings: tuple[HeadRing, ...] = (HeadRing(1.0, 1.0),)

    @classmethod
    def make_uniform(
        cls, sensor_type: SensorType, indenter: Indenter, contact_length_mm: float = CONTACT_LENGTH_MM
    ) -> Self:
        """The sheet of a scene without effects: uniform, electrodes in place, equal contacts."""
        count = sensor_type.electrodes.count
        return cls(sensor_type, indenter, np.full(count, contact_length_mm), np.zeros((count, 2)))

    def sheet_conductance_at(self, places_mm: Array) -> Array:
        """Sheet conductance over its mean, at (n, 2) places: (n,)."""
        return _product([*self.conductance, *self.thickness], places_mm)

    def response_at(self, places_mm: Array) -> Array:
        """Response over its mean, at (n, 2) places: (n,)."""
        return _product(self.response, places_mm)

    def thickness_mm_at(self, places_mm: Array) -> Array:
        """Thickness at (n, 2) places: (n,) [mm]."""
        return self.sensor_type.thickness_mm * _product(self.thickness, places_mm)


def _product(factors: list[SheetField], places_mm: Array) -> Array:
    total = np.ones(len(places_mm))
    for factor in factors:
        total *= factor(places_mm)
    return total


@dataclass(frozen=True, slots=True)
class Dump:
    """A board's watchdog dump within a frame: the board prints its log and continues later.

    Parameters
    ----------
    frame, row : frame and row before which it was.
    pause_s : delay of the rest of the frame and of all later ones.
    """

    frame: int
    row: int
    pause_s: float


@dataclass(slots=True, eq=False)
class Transcript:
    """How frames are recorded. Effects of the stage ``recording`` modify it, once, before the first frame.

    Parameters
    ----------
    time_s : (frames,) middles of the frames, on the station's clock, without pauses.
    lost : (frames, drives) rows that never arrive.
    dumps : dumps of the board's watchdog, by frame and row.
    """

    setting: SceneSetting
    time_s: Array
    lost: NDArray[np.bool_]
    dumps: list[Dump] = field(default_factory=list)

    @classmethod
    def complete(cls, setting: SceneSetting, time_s: Array) -> Self:
        """Return a transcript without lost rows and dumps."""
        rows = setting.sensor_type.pattern.shape[0]
        return cls(setting, time_s, np.zeros((len(time_s), rows), dtype=np.bool_))

    def pauses_s(self) -> Array:
        """Delay of each row by dumps, (frames, drives)."""
        delay_s = np.zeros(self.lost.size)
        for dump in self.dumps:
            delay_s[dump.frame * self.lost.shape[1] + dump.row :] += dump.pause_s
        return delay_s.reshape(self.lost.shape)


@dataclass(slots=True, eq=False)
class Moment:
    """One moment of the simulated world. Effects modify it in the scene's declared order.

    Parameters
    ----------
    time_s : time on the station's clock [s].
    index : index of the frame, or of the force sample, 0 for the geometry; random numbers are addressed with it.
    presses : all so far, also those released whose residue may linger.
    response : relative conductance change under the head, per press.
    stress_kPa : under the head, per press.
    voltages : (drives, measures) [V]; None until solved.
    force_N : what the load cell reads.
    place_mm : the head's place from the sheet's centre; in stage ``position`` the commanded one.
    depth_mm : commanded depth below the nominal surface; negative when hovering.
    from_mm, from_depth_mm : its place and depth before the move.
    surface_mm : depth of the sheet's surface there below nominal.
    reading_scale_V : mean magnitude of the used readings of the unloaded sheet [V], for effects that are stated
        relative to it.
    reading_offsets_s : (drives, measures) when each reading of a frame is taken, from the frame's time; None where
        all are taken at once.
    contact_mm : (electrodes,) contact impedance over the sheet's mean resistance; None away from a frame.
    impedance_ohm : (electrodes, electrodes) electrode potentials per electrode current; None before it was solved.
    current_A : (drives, measures) current during each reading; None before the source is on.
    drive_ohm, measure_ohm : (drives, measures) resistance between the driven, and the measured, electrodes then; None
        until solved.
    flags : (drives, measures) uint8 of :class:`cbsr_qa.domain.readings.frames.ReadingFlag`; None away from a frame.
    """

    setting: SceneSetting
    time_s: float
    index: int
    presses: list[SimulatedPress]
    response: list[float]
    stress_kPa: list[float]
    voltages: Array | None = None
    force_N: float = 0.0
    place_mm: tuple[float, float] = (0.0, 0.0)
    depth_mm: float = 0.0
    from_mm: tuple[float, float] = (0.0, 0.0)
    from_depth_mm: float = 0.0
    surface_mm: float = 0.0
    reading_scale_V: float = 0.0
    reading_offsets_s: Array | None = None
    contact_mm: Array | None = None
    impedance_ohm: Array | None = None
    current_A: Array | None = None
    drive_ohm: Array | None = None
    measure_ohm: Array | None = None
    flags: NDArray[np.uint8] | None = None

    @property
    def run_s(self) -> float:
        """The moment on the run's time line: drift over a run continues in a resumed session."""
        return self.time_s + self.setting.began_s
