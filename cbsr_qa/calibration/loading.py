"""Calibration files of every kind, read to be used; needs only numpy, scipy and h5py."""

from collections.abc import Callable
from datetime import date
from functools import partial
from pathlib import Path
from typing import Any, Final

from cbsr_qa.calibration.file.certified import check_use
from cbsr_qa.calibration.file.entries import Issued
from cbsr_qa.calibration.file.hdf5 import read_in_child, read_issued
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


def load_calibration(
    path: str | Path,
    *,
    public_key: str | Path | None = None,
    certificate: str | Path | None = None,
    withdrawn: str | Path | None = None,
    today: date | None = None,
) -> Estimator:
    """Read a calibration file, of a run or of labelled presses.

    Apply it to frames with :meth:`Estimator.estimate`. ``Calibration.load`` and ``PressCalibration.load`` read one
    kind of file and refuse the other: their objects have more methods.

    Parameters
    ----------
    public_key : PEM file with the key that must have signed it; needs ``cryptography``. None: not checked. With a
        certificate, the key that must have signed that one, which names the calibration by its SHA-256.
    certificate : signature file of its certificate, which must not have lapsed; None: not checked.
    withdrawn : list of withdrawn certificates, signed with the same key; the calibration's must not be on it.
    today : day on which the certificate must be valid; None for the computer's (UTC).

    Raises
    ------
    CalibrationError
        If the file is missing, damaged, of a later version, holds no force model, is not signed by that key, or its
        certificate is of another calibration, has lapsed, or was withdrawn.
    RefusedError
        If the key cannot be used.
    """
    issued = read_issued(Path(path))
    check_use(Path(path), issued, public_key, certificate, withdrawn, today)
    return _make_estimator(issued)


def load_foreign_calibration(
    path: Path, public_key: Path | None = None, certificate: Path | None = None, withdrawn: Path | None = None
) -> Estimator:
    """Load a calibration file of unknown origin for use, in a child process; as :func:`load_calibration`.

    CalibrationError also if reading it crashes, hangs or takes too much memory.
    """
    issued = read_in_child(path, partial(read_issued, path))
    check_use(path, issued, public_key, certificate, withdrawn)
    return _make_estimator(issued)


def _make_estimator(issued: Issued) -> Estimator:
    return ESTIMATORS[type(issued)](issued)
