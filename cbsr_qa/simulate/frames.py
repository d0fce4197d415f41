"""One frame of the simulated world, each reading taken at its own time, of a sheet or a ring of resistors."""

from bisect import bisect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.world import Moment, SheetDesign, SimulatedPress
from cbsr_qa.eit.forward.closed_forms import ring_impedance
from cbsr_qa.simulate.chain import Chain
from cbsr_qa.simulate.sheet import Place, SimulatedSheet


class SimulatedRing:
    """Resistors between neighbouring electrodes, in place of a sheet.

    It is connected in place of the sensor, so that leads, source, meter and converter affect its readings too.
    Effects on the sheet and its contacts do nothing: the resistors are soldered, and nothing is pressed. ConfigError
    if there are not as many as electrodes; NumericsError if one is not above zero.

    Parameters
    ----------
    design : design of the replaced sheet; its electrodes are the ring's terminals.
    resistances_ohm : the first between electrodes 0 and 1, the last between the last one and 0.
    """

    def __init__(self, design: SheetDesign, resistances_ohm: Sequence[float]) -> None:
        self.design = design
        self.sensor_type = design.sensor_type
        electrodes = self.sensor_type.electrodes.count
        if len(resistances_ohm) != electrodes:
            raise ConfigError(
                f"reference_ring_ohm has {len(resistances_ohm)} resistors; the sensor type has {electrodes}"
                " electrodes",
                remedy="give one for each pair of neighbouring electrodes",
            )
        self._impedance = ring_impedance(resistances_ohm)
        #: readings, (drives, measures) [V/A]
        self.unloaded: Array = self.readings(self._impedance)

    def impedances(self, changes: Sequence[Mapping[Place, float]], contact_mm: Array | None = None) -> Array:
        """The ring's impedances at every moment, (moments, electrodes, electrodes) [V/A], independent of presses."""
        return np.repeat(self._impedance[None], len(changes), axis=0)

    def readings(self, impedance_ohm: Array) -> Array:
        """Readings per ampere of a transfer impedance: (drives, measures) [V/A]."""
        pattern = self.sensor_type.pattern
        return pattern.drive_currents().T @ impedance_ohm @ pattern.measure_matrix()

    def area_under_head_mm2(self, place: Place) -> float:
        """Return no change: nothing is pressed."""
        return 0.0


#: Relative conductance change below which nothing is solved. A used reading changes by less than that, in units of
#: the mean reading, even with the head beside a pin: the error is three orders below the noise of the quieter shipped
#: material (1.9e-4 in the same units).
NEGLIGIBLE_CHANGE: Final = 1e-7

_SHORTEST_S: Final = 1e-6  # between distinct ends of ramps


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedFrame:
    """Readings of one frame, with their times.

    Parameters
    ----------
    voltages : (drives, measures) [V].
    flags : (drives, measures) uint8 flags of :class:`cbsr_qa.domain.readings.frames.ReadingFlag`.
    time_s : (drives, measures) time of each reading on the station's clock; None if all are simultaneous.
    current_A : (drives, measures) current during each reading.
    drive_ohm : (drives, measures) resistance of its driven pair at that time.
    """

    voltages: Array
    flags: NDArray[np.uint8]
    time_s: Array | None
    current_A: Array
    drive_ohm: Array


class FrameMaker:
    """Computes frames of a sheet with the effects of a scene.

    Sequential readings see the sheet at different times. It is solved at the ends of ramps within the frame, and once
    between, and readings are interpolated by parabolas: a relaxation with a time constant of 5 s in a frame of 2.5 s
    is accurate to 2e-3 of its change.
    """

    def __init__(self, sheet: SimulatedSheet | SimulatedRing, chain: Chain) -> None:
        self._sheet = sheet
        self._chain = chain
        self._pattern = sheet.sensor_type.pattern
        self._driven, self._measured = self._pattern.drive_currents(), self._pattern.measure_matrix()

    def frame(
        self, moment_at: Callable[[float], Moment], time_s: float, pauses_s: Array | None = None
    ) -> SimulatedFrame:
        """Compute the frame around a time.

        Parameters
        ----------
        moment_at : makes the moment of a time, always with the frame's own index.
        pauses_s : (drives,) delay of each row, if readings are not simultaneous.
        """
        moment = moment_at(time_s)
        self._chain.apply("times", moment)
        if pauses_s is not None and moment.reading_offsets_s is not None:
            moment.reading_offsets_s = moment.reading_offsets_s + pauses_s[:, None]
        offsets = moment.reading_offsets_s
        moment.impedance_ohm, per_ampere, drive_ohm, measure_ohm = self._solve(moment_at, moment)
        # A dead short is only rounding, of either sign; so is a parabola at the end of one.
        moment.drive_ohm, moment.measure_ohm = np.maximum(drive_ohm, 0.0), np.maximum(measure_ohm, 0.0)
        moment.current_A = np.full(self._pattern.shape, moment.setting.current_A)
        moment.flags = np.zeros(self._pattern.shape, dtype=np.uint8)
        self._chain.apply("source", moment)
        moment.voltages = per_ampere * moment.current_A
        self._chain.apply("voltages", moment)
        own_s = None if offsets is None else time_s + offsets
        return SimulatedFrame(moment.voltages, moment.flags, own_s, moment.current_A, moment.drive_ohm)

    def _solve(self, moment_at: Callable[[float], Moment], moment: Moment) -> tuple[Array, Array, Array, Array]:
        """Transfer impedance in the middle; readings per ampere and resistances of their pairs, at their times."""
        offsets = moment.reading_offsets_s
        contact_mm = self._contacts(moment)
        changes = bool(moment.presses) or self._chain.has("contacts") or self._chain.has("impedance")
        if offsets is None or not changes:
            (middle,) = self._impedances([moment], contact_mm)
            drive_ohm = np.broadcast_to(_pair_resistance(self._driven, middle)[:, None], self._pattern.shape)
            measure_ohm = np.broadcast_to(_pair_resistance(self._measured, middle), self._pattern.shape)
            return middle, self._sheet.readings(middle), drive_ohm, measure_ohm
        first_s, last_s = float(moment.time_s + offsets.min()), float(moment.time_s + offsets.max())
        knots = _knots(moment.presses, self._chain.switches(moment, first_s, last_s), first_s, last_s)
        times_s = np.concatenate([knots, (knots[1:] + knots[:-1]) / 2])
        middle_index = int(np.abs(times_s - moment.time_s).argmin())
        has_middle = abs(times_s[middle_index] - moment.time_s) <= 4 * np.spacing(moment.time_s)
        other_times_s = np.delete(times_s, middle_index) if has_middle else times_s
        middle, *impedances = self._impedances(
            [moment, *(moment_at(float(time_s)) for time_s in other_times_s)], contact_mm
        )
        if has_middle:
            impedances.insert(middle_index, middle)
        readings = np.array([self._sheet.readings(impedance) for impedance in impedances])
        drive_ohm, measure_ohm = (
            np.array([_pair_resistance(pairs, impedance) for impedance in impedances])
            for pairs in (self._driven, self._measured)
        )
        weights = _weights(knots, moment.time_s + offsets)
        return (
            middle,
            np.einsum("kdm,kdm->dm", weights, readings),
            np.einsum("kdm,kd->dm", weights, drive_ohm),
            np.einsum("kdm,km->dm", weights, measure_ohm),
        )

    def _contacts(self, moment: Moment) -> Array | None:
        """Contacts in the middle of the frame, after effects on them; None if there are none."""
        if not self._chain.has("contacts"):
            return None
        moment.contact_mm = self._sheet.design.contact_mm.copy()
        self._chain.apply("contacts", moment)
        return moment.contact_mm

    def _impedances(self, moments: Sequence[Moment], contact_mm: Array | None) -> list[Array]:
        """Transfer impedances at moments, the frame's middle first, after the effects on them."""
        for moment in moments:
            moment.contact_mm = contact_mm
            self._chain.apply("response", moment)
        solved = self._sheet.impedances([_sum_changes(moment) for moment in moments], contact_mm)
        for moment, impedance in zip(moments, solved, strict=True):
            moment.impedance_ohm = impedance
            self._chain.apply("impedance", moment)
        return [moment.impedance_ohm for moment in moments if moment.impedance_ohm is not None]


def _pair_resistance(pairs: Array, impedance_ohm: Array) -> Array:
    """Resistance of some pairs (electrodes, pairs): (pairs,)."""
    ohm: Array = np.einsum("ep,ep->p", pairs, impedance_ohm @ pairs)
    return ohm


def _sum_changes(moment: Moment) -> dict[Place, float]:
    """Sum the changes of presses at one place, without faded ones."""
    total: dict[Place, float] = {}
    for press, change in zip(moment.presses, moment.response, strict=True):
        place = (press.x_mm, press.y_mm)
        total[place] = total.get(place, 0.0) + change
    return {place: change for place, change in total.items() if abs(change) > NEGLIGIBLE_CHANGE}


def _knots(presses: Sequence[SimulatedPress], switches: Sequence[float], first_s: float, last_s: float) -> Array:
    """Times between which everything is smooth: ends of the frame, and of ramps and steps within it, (k,) rising."""
    # A step is a separate piece, too short for a reading: readings before it are not affected by it.
    steps = {end for at_s in switches for end in (at_s - 2 * _SHORTEST_S, at_s) if first_s < end < last_s}
    knots = sorted({first_s, last_s} | steps)
    for end in [end for p in presses for step in p.steps for end in (step.start_s, step.start_s + step.ramp_s)]:
        place = bisect(knots, end)
        if 0 < place < len(knots) and min(end - knots[place - 1], knots[place] - end) > _SHORTEST_S:
            knots.insert(place, end)
    return np.array(knots if len(knots) > 1 else [first_s, last_s])


def _weights(knots: Array, times_s: Array) -> Array:
    """Weights of values at the knots and, after them, at the middles between them: (2 k − 1, …) for times (…)."""
    count = len(knots)
    piece = np.clip(np.searchsorted(knots, times_s, side="right") - 1, 0, count - 2)
    length = knots[piece + 1] - knots[piece]
    piece_share = np.where(length > 0, (times_s - knots[piece]) / np.where(length > 0, length, 1), 0.0)
    weights = np.zeros((2 * count - 1, *times_s.shape))
    for node, value in (
        (piece, (1 - piece_share) * (1 - 2 * piece_share)),
        (piece + 1, piece_share * (2 * piece_share - 1)),
        (count + piece, 4 * piece_share * (1 - piece_share)),
    ):
        np.put_along_axis(weights, node[None], np.take_along_axis(weights, node[None], 0) + value, 0)
    return weights
