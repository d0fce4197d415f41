"""What every test may use."""

import os
from pathlib import Path

import pytest

# As the command line does, before numpy is loaded: several workers with several threads each are far slower.
os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

_SHARED = Path(__file__).resolve().parents[2] / "shared"


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder with real recordings and reference numbers; skips, saying so, where it is absent."""
    if not (_SHARED / "data").is_dir():
        pytest.skip(f"the recordings and reference numbers are not at {_SHARED}")
    return _SHARED
