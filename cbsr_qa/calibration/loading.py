"""Calibration files of every kind, read to be used; needs only numpy, scipy and h5py."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Final

from cbsr_qa.calibration.file.entries import Issued
from cbsr_qa.calibration.file.hdf5 import read_in_child, read_issued
from cbsr_qa.calibration.file.signing import check_signed_file
from cbsr_qa.calibration.runtime.calibration import Calibration
from cbsr_qa.calibration.runtime.estimator import Estimator
from cbsr_qa.calibration.runtime.press_calibration import PressCalibration
from cbsr_qa.domain.results.calibration import Calibration as IssuedByRun
from cbsr_qa.domain.results.press_calibration import PressCalibration as IssuedFromPresses

#: Estimators that apply the content of a file, by its type. Another way to calibrate is another entry.
ESTIMATORS: Final[dict[type, Callable[[Any], Estimator]]] = {
    IssuedByRun: Calibration,
    IssuedFromPresses: PressCalibration,
}


def load_calibration(path: str | Path, *, public_key: str | Path | None = None) -> Estimator:
    """Read a calibration file, of a run or of labelled presses.

    Apply it to frames with :meth:`Estimator.estimate`. ``Calibration.load`` and ``PressCalibration.load`` read one
    kind of file and refuse the other: their objects have more methods.

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
    return _make_estimator(Path(path), read_issued(Path(path)), public_key)


def load_foreign_calibration(path: Path, public_key: Path | None = None) -> Estimator:
    """Load a calibration file of unknown origin for use, in a child process.

    CalibrationError also if reading it crashes, hangs or takes too much memory.
    """
    return _make_estimator(path, read_in_child(path, partial(read_issued, path)), public_key)


def _make_estimator(path: Path, issued: Issued, public_key: str | Path | None) -> Estimator:
    if public_key is not None:
        check_signed_file(path, issued, public_key)
    return ESTIMATORS[type(issued)](issued)
