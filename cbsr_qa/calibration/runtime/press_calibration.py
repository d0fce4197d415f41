"""A calibration from labelled presses, in use: changes of readings in; place, force and depth out.

Needs only numpy, scipy and h5py.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Final, Self

import numpy as np
from numpy.typing import ArrayLike

from cbsr_qa.calibration.file.hdf5 import read_issued
from cbsr_qa.calibration.file.signing import check_signed_file
from cbsr_qa.calibration.force.faults import FaultFinder
from cbsr_qa.calibration.force.inverse import Flag
from cbsr_qa.calibration.force.shared_error import SharedError
from cbsr_qa.calibration.place.estimator import PlaceEstimator
from cbsr_qa.calibration.place.modelled import ModelledEstimator
from cbsr_qa.calibration.place.pairs import DistinctPairs, match_readings
from cbsr_qa.calibration.place.places import Places
from cbsr_qa.calibration.place.quantity import Quantities, QuantityEstimator, widen_intervals
from cbsr_qa.calibration.runtime.estimator import (
    AS_CALIBRATED,
    Ability,
    CalibrationIdentity,
    FrameSequence,
    ModelledTouches,
    Regions,
    Touches,
    TouchValues,
    UnloadedFrames,
    mask_unusable,
    require_ability,
)
from cbsr_qa.calibration.runtime.frames import read_frames
from cbsr_qa.domain.errors import CalibrationError, RecordingError
from cbsr_qa.domain.goodness import ALLOWANCE
from cbsr_qa.domain.numbers import Array, Indices, Mask
from cbsr_qa.domain.plan.standards import describe_force_error
from cbsr_qa.domain.readings.frames import FrameBlock, Recording, ScanKind
from cbsr_qa.domain.results.press_calibration import PRESS_QUANTITIES, PressCalibration as Issued
from cbsr_qa.domain.sensor.patterns import DrivePattern

_AXES: Final = "mm, in the frame of the labels of the presses that calibrated"
_LACKS: Final = {
    Ability.STDERR: "was learned from presses, which tell intervals and regions",
    Ability.DETECTABILITY: "was learned from presses, and not from the noise of frames",
    Ability.SETTLING: "was learned from presses, and not from how loads settle",
    Ability.GIVEN_PLACE: "was learned from presses: it finds the places itself",
    Ability.SERIAL: "states no serial number",
}
_UNCHECKED: Final = "a calibration from presses states no serial number: that it is of this sensor is not checked"


class PressCalibration:
    """Calibration learned from labelled presses, ready to be applied.

    An :class:`~cbsr_qa.calibration.runtime.estimator.Estimator`. Changes of the calibrated readings alone are located
    by :meth:`places`; faults are found in whole frames only.

    Attributes
    ----------
    issued : content of the file; ``issued.pairs`` (m, 4) names each reading, ``issued.rest`` (m,) the unloaded frame.
    q68, q95 : the region of that probability is all offsets d with dᵀΣ⁻¹d at most this, Σ of ``covariance_mm2``.
    lacks, regions, force_error : attributes of the Protocol.
    """

    sensor_type: None = None
    head: None = None

    def __init__(self, issued: Issued) -> None:
        self.issued = issued
        self._shared_error = SharedError(issued.standards)
        self._modelled = None if issued.modelled is None else ModelledEstimator(issued.modelled, issued.registration)
        self._locate = PlaceEstimator(issued.place, self._modelled, issued.pairs, issued.held_out_mm)
        self.q68, self.q95 = float(self._locate.q68), float(self._locate.q95)
        self.regions = Regions(self.q68, self.q95)
        learned = {name: getattr(issued, name) for name in PRESS_QUANTITIES}
        self._quantities = {
            name: QuantityEstimator(quantity) for name, quantity in learned.items() if quantity is not None
        }
        missing = PRESS_QUANTITIES.keys() - self._quantities.keys()
        self.lacks: Mapping[Ability, str] = _LACKS | {
            Ability(name): f"was learned from presses that had no {name}" for name in missing
        }
        self._find_faults: FaultFinder | None = None
        if issued.rest is not None:
            noise = np.zeros(len(issued.rest)) if issued.noise is None else issued.noise
            self._find_faults = FaultFinder(issued.pairs, issued.rest, noise)

    def __repr__(self) -> str:
        issued = self.issued
        return f"<PressCalibration of a {issued.sensor_type}, {issued.used} presses, {len(issued.pairs)} readings>"

    @classmethod
    def load(cls, path: str | Path, *, public_key: str | Path | None = None) -> Self:
        """Read a calibration file that ``cbsr-qa calibrate`` has learned from labelled presses.

        Parameters
        ----------
        public_key : PEM file with the key that must have signed it; needs ``cryptography``. None: not checked.

        Raises
        ------
        CalibrationError
            If the file is missing, damaged, of a later version, was issued by a run, or is not signed by that key.
        RefusedError
            If the key cannot be used.
        """
        issued = read_issued(Path(path))
        if public_key is not None:
            check_signed_file(path, issued, public_key)
        if not isinstance(issued, Issued):
            raise CalibrationError(
                f"calibration file {path}: issued by a run", remedy="Calibration.load or load_calibration reads it"
            )
        return cls(issued)

    @property
    def identity(self) -> CalibrationIdentity:
        """Identity of the calibration."""
        issued = self.issued
        return CalibrationIdentity(
            "", issued.calibration, issued.digest, "presses", issued.sensor_type, issued.electrodes, _AXES
        )

    @property
    def force_error(self) -> str:
        """What intervals of force include, in words."""
        return describe_force_error(self.issued.standards)

    @cached_property
    def pattern(self) -> DrivePattern:
        """Pattern of the frames that it was learned from."""
        return DrivePattern(self.issued.electrodes, self.issued.drive, self.issued.measure)

    def places(self, changes: ArrayLike) -> Places:
        """Locate touches in changes (n, m): frames minus the unloaded one, in the order of ``issued.pairs``.

        CalibrationError if the shape is another.
        """
        return self._locate(np.asarray(changes, dtype=np.float64))

    def force(self, places: Places) -> Quantities:
        """Return the force [N] of each touch, with intervals. CalibrationError if the presses had no forces."""
        require_ability(self, Ability.FORCE, "calibrate with labels of it")
        return self._estimate_quantity("force", places)[0]

    def depth(self, places: Places) -> Quantities:
        """Return the depth [mm] of each touch, with intervals. CalibrationError if the presses had no depths."""
        require_ability(self, Ability.DEPTH, "calibrate with labels of it")
        return self._estimate_quantity("depth", places)[0]

    def _estimate_quantity(self, name: str, places: Places) -> tuple[Quantities, Array | None]:
        """Return a quantity, and the standard error that all its values share, which its intervals hold; or None."""
        quantity = self._quantities[name](places)
        if name != "force" or not self.issued.standards:
            return quantity, None
        shared_N = self._shared_error.stderr_N(quantity.values)
        return widen_intervals(quantity, shared_N), shared_N

    def estimate(self, frames: ArrayLike) -> Touches:
        """Estimate the touch in each frame, against the unloaded frame of the calibration; see :class:`Estimator`."""
        pattern, read = self.pattern, read_frames(frames)
        if read.shape[-2:] != pattern.shape or read.ndim not in (2, 3):
            raise CalibrationError(
                f"frames of shape {read.shape} are not of this calibration",
                remedy=f"its frames are (drives, measures) = {pattern.shape}, one or many",
            )
        rows = read.reshape(-1, *pattern.shape)[:, pattern.usable()]
        return self._estimate_selected(rows, self._selection)

    def prepare(self) -> None:
        """Compute what is computed only once."""
        self.places(np.zeros((1, self._selection.shape[1])))

    def check_recording(self, recording: Recording) -> None:
        """Refuse a recording of another sensor type or pattern than the calibration: RecordingError."""
        if recording.sensor_type not in (None, self.issued.sensor_type):
            raise RecordingError(
                f"{recording.path.name} is of sensor type {recording.sensor_type}, the calibration is of a"
                f" {self.issued.sensor_type}",
                remedy="apply the calibration that was learned from this sensor",
            )
        check_pressed_recording(recording, self.pattern)

    def follow(
        self,
        name: str,
        first: FrameBlock,
        unloaded: UnloadedFrames = AS_CALIBRATED,
        *,
        timed: bool = True,
        place_mm: ArrayLike | None = None,
    ) -> FrameSequence:
        """Begin to estimate the frames of an instrument or a recording; see :class:`Estimator`."""
        if place_mm is not None:
            require_ability(self, Ability.GIVEN_PLACE, "leave the place out")
        rest_frames = unloaded.rest
        if unloaded.first is not None:
            if not 1 <= unloaded.first <= len(first):
                raise RecordingError(f"--reference {unloaded.first} of {name}; it holds {len(first)} frames")
            rest_frames = first.select(slice(0, unloaded.first))
        usable_mask = self.pattern.usable()
        rest_readings = None if rest_frames is None else mask_unusable(rest_frames)[:, usable_mask]
        if rest_readings is not None and not np.isfinite(rest_readings).all():
            frames_name = (
                f"the first {unloaded.first} frames of {name}" if unloaded.first else f"the frames at rest of {name}"
            )
            raise RecordingError(f"a reading of {frames_name} is missing or saturated")
        if rest_readings is None and not unloaded.differences:
            self._require_rest()
        estimate = partial(
            self._estimate_selected,
            selection=self._selection,
            relative=rest_readings is not None,
            differences=unloaded.differences,
        )
        remarks = (
            (_UNCHECKED,)
            if Ability.FORCE in self.lacks
            else (_UNCHECKED, f"errors of force include {self.force_error}")
        )
        return _Sequence(usable_mask, 0.0 if rest_readings is None else rest_readings.mean(axis=0), estimate, remarks)

    def estimate_readings(
        self, pairs: Indices, readings: Array, *, relative: bool = False, differences: bool = False
    ) -> Touches:
        """Estimate the touches in rows of readings of named pairs; see :class:`Estimator`."""
        selection = match_readings(self.issued.pairs, pairs)
        return self._estimate_selected(readings, selection, relative=relative, differences=differences)

    def _estimate_selected(
        self, readings: Array, selection: Array, *, relative: bool = False, differences: bool = False
    ) -> Touches:
        """Estimate the touches in rows of readings (n, k), which ``selection`` (k, m) makes the calibrated ones."""
        missing_mask = np.isnan(readings)
        changes: Array = np.where(
            missing_mask @ (selection != 0), np.nan, np.where(missing_mask, 0.0, readings) @ selection
        )
        if not (relative or differences):
            changes = changes - self._require_rest()
        sound_changes, faults = changes, None
        if self._find_faults is not None and not differences:
            faults = self._find_faults(self._require_rest() + changes)
            sound_changes = np.where(faults.left_out, np.nan, changes)
        places = self._locate(changes, faults)
        with np.errstate(over="ignore"):  # frames without a touch have no quantities
            quantities = {name: self._estimate_quantity(name, places) for name in self._quantities}
        modelled = None if self._modelled is None else self._modelled(sound_changes)
        return _make_touches(places, self.regions, quantities, modelled)

    @cached_property
    def _selection(self) -> Array:
        """Matrix (k, m) from the usable readings of a frame to the calibrated ones.

        CalibrationError if a calibrated pair is not among them.
        """
        return match_readings(self.issued.pairs, DistinctPairs.from_pattern(self.pattern).pairs)

    def _require_rest(self) -> Array:
        if self.issued.rest is None:
            raise CalibrationError(
                "the calibration was made from changes and holds no unloaded frame",
                remedy="give --differences if the readings are changes, --rest FILE with frames of the unloaded"
                " sheet, or --reference N if the first N frames of a recording are",
            )
        return self.issued.rest


@dataclass(frozen=True, slots=True, eq=False)
class _Sequence:
    usable: Mask
    rest: Array | float
    estimate_rows: Callable[[Array], Touches]
    remarks: tuple[str, ...]

    def estimate(self, frames: FrameBlock) -> Touches:
        return self.estimate_rows(mask_unusable(frames)[:, self.usable] - self.rest)


def check_pressed_recording(recording: Recording, pattern: DrivePattern) -> None:
    """Refuse a recording whose frames are not signed readings in a pattern: RecordingError says what was found."""
    shape = recording.frames.voltages.shape[1:]
    if recording.scan is not ScanKind.FULL or shape != pattern.shape or recording.magnitudes_only:
        raise RecordingError(
            f"{recording.path.name} holds frames of {shape[0]} × {shape[1]} readings; signed ones of"
            f" {pattern.shape[0]} × {pattern.shape[1]} are needed for the sensor type's pattern",
            remedy="give the sensor type that was recorded",
        )


def _make_touches(
    places: Places,
    regions: Regions,
    quantities: Mapping[str, tuple[Quantities, Array | None]],
    modelled: Places | None,
) -> Touches:
    flags = places.flags.copy()
    for quantity, _ in quantities.values():
        finite_mask = np.isfinite(quantity.values)
        flags |= (finite_mask & quantity.below) * int(Flag.BELOW_RANGE) | (finite_mask & quantity.above) * int(
            Flag.ABOVE_RANGE
        )
    placed_mask: Mask = np.asarray(np.isfinite(places.place_mm).all(axis=1))
    largest_variance = np.full(len(placed_mask), np.nan)
    largest_variance[placed_mask] = np.linalg.eigvalsh(places.covariance_mm2[placed_mask])[:, -1]
    half_axis_mm = np.sqrt(np.maximum(largest_variance, 0.0))
    values = {
        name: TouchValues(quantity.values, quantity.within_68, quantity.within_95, shared_stderr=shared)
        for name, (quantity, shared) in quantities.items()
    }
    modelled_touches = None
    if modelled is not None:
        explained: Array = 1 / (1 + ALLOWANCE * modelled.misfit)
        modelled_touches = ModelledTouches(modelled.place_mm, modelled.covariance_mm2, explained, modelled.in_model)
    return Touches(
        touch=(flags & int(Flag.UNREADABLE | Flag.NOT_DETECTED)) == 0,
        flags=flags,
        place_mm=places.place_mm,
        place_stderr_mm=None,
        radius_68_mm=half_axis_mm * float(np.sqrt(regions.q68)),
        radius_95_mm=None if regions.q95 is None else half_axis_mm * float(np.sqrt(regions.q95)),
        covariance_mm2=places.covariance_mm2,
        force=values.get("force"),
        depth=values.get("depth"),
        modelled=modelled_touches,
    )
