"""Calibrations in use; needs only numpy, scipy and h5py."""

from pathlib import Path

from cbsr_qa.calibration import Calibration, Flag, ForceStream
from cbsr_qa.calibration.force import PressureMap

__all__ = ["Calibration", "Flag", "ForceStream", "PressureMap", "load_calibration"]


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
