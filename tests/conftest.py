"""What every test may use."""

from pathlib import Path

import pytest

_SHARED = Path(__file__).resolve().parents[2] / "shared"


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder with real recordings and reference numbers; skips, saying so, where it is absent."""
    if not (_SHARED / "data").is_dir():
        pytest.skip(f"the recordings and reference numbers are not at {_SHARED}")
    return _SHARED
