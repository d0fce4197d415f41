"""A calibration file as it was issued."""

from pathlib import Path

import pytest
from calibration_samples import sample_calibration

from cbsr_qa.calibration.file.hdf5 import write_calibration


@pytest.fixture
def issued(tmp_path: Path) -> Path:
    path = tmp_path / "calibrations" / "S-001.h5"
    write_calibration(path, sample_calibration())
    return path
