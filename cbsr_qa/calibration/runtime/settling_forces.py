"""Forces of single frames, corrected where a stream of the same frames shows loads that have not settled."""

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from cbsr_qa.calibration.force.inverse import NO_FORCE, Flag, Forces, range_flags
from cbsr_qa.calibration.runtime.head_forces import HeadForces
from cbsr_qa.calibration.runtime.track import kernel_at
from cbsr_qa.calibration.runtime.tracking import ForceStream, LoadState, TrackedLoad
from cbsr_qa.domain.numbers import Array

_RANGE: Final = int(Flag.OUTSIDE | Flag.BELOW_RANGE | Flag.ABOVE_RANGE)
#: Share of a force that may still be to come if the stream does not see the load that the frame shows.
_UNKNOWN: Final = 0.3


class SettlingForces:
    """Follows the frames of a recording, and flags forces that do not count yet.

    Parameters
    ----------
    calibration : calibration of the sensor.
    """

    def __init__(self, calibration: HeadForces) -> None:
        self._calibration, self._stream = calibration, ForceStream(calibration)
        self._diameter_mm = calibration.issued.indenter.diameter_mm

    def __call__(self, time_s: Array, frames: Array, forces: Forces) -> tuple[Forces, Array]:
        """Correct the forces of the next frames.

        Parameters
        ----------
        time_s : (n,) rising times, later than those of earlier calls [s].
        frames : (n, drives, measures) voltages [V].
        forces : forces of these frames, each estimated by itself.

        Returns
        -------
        Forces, and the time (n,) until each counts [s]: 0 where it does, NaN where that is not known. Those that do
        not are flagged UNSETTLED: the force that a load will have after the calibrated hold, with the error of that
        prediction; of a released load 0, with all that the frame shows as its error; without a kernel, or with
        several heads, that of the frame itself, with 30 % added to its error.

        The error of a load held longer than the calibrated ones grows by the creep that its kernel predicts since.

        CalibrationError as for :meth:`ForceStream.update`.
        """
        # The shared error is not one of settling: it is added to the corrected force.
        scatter_N = np.sqrt(np.maximum(forces.stderr_N**2 - forces.shared_stderr_N**2, 0.0))
        single = replace(forces, stderr_N=scatter_N)
        corrections = [
            self._sum_loads(self._stream.update(time, frame), single.part(slice(n, n + 1)), time)
            for n, (time, frame) in enumerate(zip(time_s.tolist(), frames, strict=True))
        ]
        if not corrections:
            return forces, np.zeros(0)
        force, stderr, flags, settled_in_s = (np.array(column) for column in zip(*corrections, strict=True))
        return self._calibration.shared_error.add(
            replace(forces, force_N=force, stderr_N=stderr, flags=flags)
        ), settled_in_s

    def add_frame(self, time_s: float, frame: Array, *, place_mm: ArrayLike | None = None) -> tuple[Forces, Array]:
        """Force of the next frame (drives, measures) [V], and the time (1,) until it counts [s].

        The force of :meth:`HeadForces.force`, corrected as a call of this object corrects it, to the last bit.
        """
        return self(np.array([time_s]), frame[None], self._calibration.force(frame, place_mm=place_mm))

    def _sum_loads(
        self, loads: tuple[TrackedLoad, ...], single: Forces, time_s: float
    ) -> tuple[float, float, int, float]:
        """Force, error, flags and time until both can be relied on, of a frame with the loads seen in it."""
        force, stderr, flags = float(single.force_N[0]), float(single.stderr_N[0]), int(single.flags[0])
        if flags & (NO_FORCE | Flag.NOT_DETECTED) or not loads:
            return force, stderr, flags, 0.0
        distance_mm = np.array([np.hypot(*(load.place_mm - single.place_mm[0])) for load in loads])
        pressing = [
            load for load, mm in zip(loads, distance_mm, strict=True) if _presses(load) and mm < self._diameter_mm
        ]
        load = pressing[-1] if pressing else loads[int(distance_mm.argmin())]
        if len(pressing) > 1 or (flags & Flag.MORE_THAN_ONE and any(track.settled_in_s != 0 for track in loads)):
            return force, float(np.hypot(stderr, _UNKNOWN * force)), flags | Flag.UNSETTLED, np.nan
        if load.settled_in_s != 0 and _presses(load) and self._calibration.model.loading is None:
            return force, float(np.hypot(stderr, _UNKNOWN * force)), flags | Flag.UNSETTLED, load.settled_in_s
        if load.settled_in_s == 0:
            return force, float(np.hypot(stderr, self._crept(time_s - load.since_s, load) * force)), flags, 0.0
        force, stderr = (load.force_N, load.scatter_N) if _presses(load) else (0.0, float(np.hypot(force, stderr)))
        validity = self._calibration.issued.validity
        in_range = int(range_flags(np.array([force]), np.array([stderr]), single.place_mm, validity)[0])
        return force, stderr, flags & ~_RANGE | in_range | Flag.UNSETTLED, load.settled_in_s

    def _crept(self, held_s: float, load: TrackedLoad) -> float:
        """Share of its force by which a settled load has crept since the calibrated hold."""
        model = self._calibration.model
        if model.loading is None or load.state is not LoadState.STEADY:
            return 0.0
        return float(kernel_at(model.loading, held_s) / kernel_at(model.loading, model.steady_s)) - 1


def _presses(load: TrackedLoad) -> bool:
    return load.state in (LoadState.LOADING, LoadState.STEADY)
