"""A calibration file as it was issued."""

from pathlib import Path

import pytest
from calibration_samples import sample_calibration

from cbsr_qa.calibration.file.hdf5 import write_calibration


@pytest.fixture(scope="session")
def issued_bytes(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("issued") / "S-001.h5"
    write_calibration(path, sample_calibration())
    return path.read_bytes()


@pytest.fixture
def issued(tmp_path: Path, issued_bytes: bytes) -> Path:
    """A file of one's own, to change."""
    path = tmp_path / "calibrations" / "S-001.h5"
    path.parent.mkdir()
    path.write_bytes(issued_bytes)
    return path
