"""A small signed calibration, and keys, for tests of signatures."""

from datetime import UTC, datetime
from pathlib import Path

from calibration_samples import sparse_calibration

from cbsr_qa.calibration.file.hdf5 import sign_calibration, stamp
from cbsr_qa.calibration.file.keys import new_key, signing_key
from cbsr_qa.domain.results.calibration import Calibration

AT = datetime(2026, 11, 27, 9, 30, 15, 400_000, tzinfo=UTC)


def made_key(folder: Path, name: str = "a.key") -> Path:
    """Make a key pair in a folder; return the private key's file."""
    path = folder / name
    new_key(path)
    return path


def signed_sample(key: Path) -> Calibration:
    """A small calibration, issued and signed."""
    return sign_calibration(stamp(sparse_calibration()), signing_key(key), AT)
