"""Calibrations in use; needs only numpy, scipy and h5py."""

from pathlib import Path

from cbsr_qa.calibration import Calibration, Flag, ForceStream
from cbsr_qa.calibration.force import PressureMap

__all__ = ["Calibration", "Flag", "ForceStream", "PressureMap", "load_calibration"]


def load_calibration(path: str | Path) -> Calibration:
    """Read the calibration file of a sensor that a run has calibrated.

    Apply it to frames with :meth:`Calibration.force`, to several heads with :meth:`Calibration.forces`, to a stream
    with ``ForceStream(calibration)``.

    Raises
    ------
    CalibrationError
        If the file is missing, damaged, of a later version, or holds no force model.
    """
    return Calibration.load(path)
