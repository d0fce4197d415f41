"""The calibration of a sensor that a run issued, in use: frames in, newtons out. Needs only numpy, scipy and h5py."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Final, Self

import numpy as np
from numpy.typing import ArrayLike

from cbsr_qa.calibration.file.certified import check_use
from cbsr_qa.calibration.file.hdf5 import read_calibration
from cbsr_qa.calibration.force.inverse import Flag, Forces, join_forces
from cbsr_qa.calibration.runtime.estimator import (
    AS_CALIBRATED,
    Ability,
    CalibrationIdentity,
    FrameSequence,
    Touches,
    TouchValues,
    UnloadedFrames,
    require_ability,
)
from cbsr_qa.calibration.runtime.frame_scale import FrameScale, check_recording
from cbsr_qa.calibration.runtime.head_forces import HeadForces
from cbsr_qa.calibration.runtime.settling_forces import SettlingForces
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.numbers import Array, Indices
from cbsr_qa.domain.plan.standards import describe_force_error
from cbsr_qa.domain.readings.frames import FrameBlock, Recording
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.domain.sensor.patterns import DrivePattern
from cbsr_qa.domain.sensor.sensor_type import SensorType

if TYPE_CHECKING:
    from cbsr_qa.domain.results.expanded_force import ExpandedForce

#: Values of dᵀΣ⁻¹d that hold 68 % and 95 % of a normal distribution over two axes.
_Q68, _Q95 = (float(-2 * np.log(1 - share)) for share in (0.6827, 0.95))
_AXES: Final = "mm from the sheet's centre, as the sensor type places its electrodes"
_BY_RUN: Final = "was issued by a run"
_LACKS: Final = {
    Ability.DEPTH: f"{_BY_RUN}, whose depths it does not hold",
    Ability.REGION: f"{_BY_RUN}: the error of a place is one number",
    Ability.READINGS: _BY_RUN,
}


class Calibration(HeadForces):
    """One sensor's calibration by a run, ready to be applied.

    An :class:`~cbsr_qa.calibration.runtime.estimator.Estimator`, which also takes places, other heads and currents.

    CalibrationError if it has no force model: no load of its run gave one.
    """

    lacks: Mapping[Ability, str] = _LACKS
    regions: None = None

    def __repr__(self) -> str:
        validity, head = self.issued.validity, self.issued.indenter.words()
        force = "" if validity.force_N is None else ", {:.3g} to {:.3g} N".format(*validity.force_N)
        area = f"within {validity.radius_mm:.3g} mm of the centre"
        return f"<Calibration of sensor {self.issued.sensor.serial}{force} {area}, head: {head}>"

    @classmethod
    def load(
        cls,
        path: str | Path,
        *,
        public_key: str | Path | None = None,
        certificate: str | Path | None = None,
        withdrawn: str | Path | None = None,
        today: date | None = None,
    ) -> Self:
        """Read a calibration file that a run issued.

        Parameters
        ----------
        public_key, certificate, withdrawn, today : as :func:`~cbsr_qa.calibration.loading.load_calibration`.

        Raises
        ------
        CalibrationError
            If it is damaged, of a later version, not issued by a run, without a force model, not signed by that key,
            or its certificate is of another calibration, has lapsed, or was withdrawn.
        RefusedError
            If the key cannot be used.
        """
        issued = read_calibration(Path(path))
        check_use(Path(path), issued, public_key, certificate, withdrawn, today)
        return cls(issued)

    @property
    def identity(self) -> CalibrationIdentity:
        """Identity of the calibration."""
        issued = self.issued
        return CalibrationIdentity(
            issued.sensor.serial,
            issued.calibration,
            issued.digest,
            "run",
            issued.sensor_type.name,
            issued.sensor_type.electrodes.count,
            _AXES,
        )

    @property
    def sensor_type(self) -> SensorType:
        """Sensor type of its frames."""
        return self.issued.sensor_type

    @property
    def pattern(self) -> DrivePattern:
        """Pattern of its frames."""
        return self.issued.sensor_type.pattern

    @property
    def head(self) -> Indenter:
        """Head that it was learned with."""
        return self.issued.indenter

    @property
    def force_error(self) -> str:
        """What standard errors of force include."""
        return describe_force_error(self.issued.standards)

    def expand(self, forces: Forces) -> "tuple[ExpandedForce | None, ...]":
        """Return the expanded uncertainty (U and k of 95 %) of each force that frames told, with its budget.

        None for frames without a load, for forces of other heads, and for what is outside the calibrated range or
        the load cell's certificate.
        Needs ``GTC``: CalibrationError if that is missing.
        """
        try:
            import GTC  # noqa: F401 - a robot that needs no U does without it
        except ImportError as error:
            raise CalibrationError("expanded uncertainties need GTC", remedy="pip install GTC") from error
        from cbsr_qa.calibration.uncertainty.budget import expand_forces

        return expand_forces(self.issued, forces)

    def estimate(self, frames: ArrayLike) -> Touches:
        """Estimate the touch in each frame, as :meth:`force` does; see :class:`Estimator`."""
        return _make_touches(self.force(frames), None)

    def prepare(self) -> None:
        """Compute what is computed only once."""
        self.force(self.issued.reference)

    def check_recording(self, recording: Recording) -> None:
        """Refuse a recording of another sensor type, scan or geometry: RecordingError."""
        check_recording(self.issued, recording)

    def follow(
        self,
        name: str,
        first: FrameBlock,
        unloaded: UnloadedFrames = AS_CALIBRATED,
        *,
        timed: bool = True,
        place_mm: ArrayLike | None = None,
    ) -> FrameSequence:
        """Begin to follow loads over the frames of an instrument or a recording; see :class:`Estimator`."""
        if unloaded.rest is not None or unloaded.differences:
            require_ability(self, Ability.READINGS, "give whole frames, and --reference for first ones at rest")
        scale = FrameScale.from_frames(self.issued, name, first, unloaded.first)
        return _Sequence(self, scale, place_mm, SettlingForces(self) if timed else None)

    def estimate_readings(
        self, pairs: Indices, readings: Array, *, relative: bool = False, differences: bool = False
    ) -> Touches:
        """Raise CalibrationError: its readings are those of whole frames."""
        raise CalibrationError(f"the calibration {self.lacks[Ability.READINGS]}", remedy="give whole frames")


@dataclass(frozen=True, slots=True, eq=False)
class _Sequence:
    calibration: Calibration
    scale: FrameScale
    place_mm: ArrayLike | None
    settling: SettlingForces | None

    @property
    def remarks(self) -> tuple[str, ...]:
        return (*self.scale.remarks, f"errors of force include {self.calibration.force_error}")

    def estimate(self, frames: FrameBlock) -> Touches:
        voltages = self.scale.voltages(frames)
        if self.settling is None:
            return _make_touches(self.calibration.force(voltages, place_mm=self.place_mm), None)
        in_turn = zip(frames.time_s.tolist(), voltages, strict=True)
        estimates = [self.settling.add_frame(time_s, frame, place_mm=self.place_mm) for time_s, frame in in_turn]
        forces = join_forces(
            [(np.array([number]), frame_forces) for number, (frame_forces, _) in enumerate(estimates)]
        )
        return _make_touches(forces, np.concatenate([settled_in_s for _, settled_in_s in estimates]))


def _make_touches(forces: Forces, settled_in_s: Array | None) -> Touches:
    """Return forces with their intervals; ``settled_in_s`` is None where frames were not followed."""
    count = len(forces.flags)
    within_68, within_95 = (np.stack(forces.interval_N(share), axis=1) for share in (0.6827, 0.95))
    # A released load has a force of exactly 0 as long as the sheet shows it.
    pressed = np.isfinite(forces.force_N) & (forces.force_N != 0) & (forces.flags & Flag.NOT_DETECTED == 0)
    return Touches(
        touch=pressed,
        flags=forces.flags,
        place_mm=forces.place_mm,
        place_stderr_mm=forces.place_stderr_mm,
        radius_68_mm=forces.place_stderr_mm * float(np.sqrt(_Q68)),
        radius_95_mm=forces.place_stderr_mm * float(np.sqrt(_Q95)),
        force=TouchValues(forces.force_N, within_68, within_95, forces.stderr_N, forces.shared_stderr_N),
        detectability=forces.detectability,
        settled_in_s=np.full(count, np.nan) if settled_in_s is None else settled_in_s,
    )
