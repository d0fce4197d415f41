"""Calibration files, read to be used; needs only numpy, scipy and h5py."""

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from cbsr_qa.calibration.file.hdf5 import read_issued
from cbsr_qa.calibration.file.signing import check_signed_file
from cbsr_qa.calibration.place.estimator import PlaceEstimator
from cbsr_qa.calibration.place.modelled import ModelledEstimator
from cbsr_qa.calibration.place.places import Places
from cbsr_qa.calibration.place.quantity import Quantities, QuantityEstimator
from cbsr_qa.calibration.runtime.runtime import Calibration
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.results.learned_quantity import LearnedQuantity
from cbsr_qa.domain.results.press_calibration import PressCalibration as Issued


def load_calibration(path: str | Path, *, public_key: str | Path | None = None) -> Calibration:
    """Read the calibration file of a sensor that a run has calibrated.

    Apply it to frames with :meth:`Calibration.force`, to several heads with :meth:`Calibration.forces`, to a stream
    with ``ForceStream(calibration)``.

    Parameters
    ----------
    public_key : PEM file with the key that must have signed it; needs ``cryptography``. None: not checked.

    Raises
    ------
    CalibrationError
        If the file is missing, damaged, of a later version, holds no force model, or is not signed by that key.
    RefusedError
        If the key cannot be used.
    """
    return Calibration.load(path, public_key=public_key)


class PressCalibration:
    """What was learned from labelled presses, ready to be applied to changes of readings.

    Attributes
    ----------
    issued : content of the file; ``issued.pairs`` (m, 4) names each reading, ``issued.rest`` (m,) the unloaded frame.
    q68, q95 : the region of that probability is all offsets d with dᵀΣ⁻¹d at most this, Σ of ``covariance_mm2``.
    """

    def __init__(self, issued: Issued) -> None:
        modelled = None if issued.modelled is None else ModelledEstimator(issued.modelled, issued.registration)
        self.issued = issued
        self._locate = PlaceEstimator(issued.place, modelled, issued.pairs, issued.held_out_mm)
        self.q68, self.q95 = float(self._locate.q68), float(self._locate.q95)

    def __repr__(self) -> str:
        issued = self.issued
        return f"<PressCalibration of a {issued.sensor_type}, {issued.used} presses, {len(issued.pairs)} readings>"

    def places(self, changes: ArrayLike) -> Places:
        """Locate touches in changes (n, m): frames minus the unloaded one, in the order of ``issued.pairs``.

        CalibrationError if the shape is another.
        """
        return self._locate(np.asarray(changes, dtype=np.float64))

    def force(self, places: Places) -> Quantities:
        """Return the force [N] of each touch, with intervals. CalibrationError if the presses had no forces."""
        return _quantity("force", self.issued.force, places)

    def depth(self, places: Places) -> Quantities:
        """Return the depth [mm] of each touch, with intervals. CalibrationError if the presses had no depths."""
        return _quantity("depth", self.issued.depth, places)


def _quantity(name: str, learned: LearnedQuantity | None, places: Places) -> Quantities:
    if learned is None:
        raise CalibrationError(f"the presses of this calibration had no {name}", remedy="calibrate with labels of it")
    return QuantityEstimator(learned)(places)


def load_press_calibration(path: str | Path, *, public_key: str | Path | None = None) -> PressCalibration:
    """Read a calibration file that ``cbsr-qa calibrate`` has learned from labelled presses.

    Parameters
    ----------
    public_key : as for :func:`cbsr_qa.load_calibration`.

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
        raise CalibrationError(f"calibration file {path}: issued by a run", remedy="load_calibration reads it")
    return PressCalibration(issued)
