"""The run that sections are rendered of."""

import pytest
from report_samples import sample_run


@pytest.fixture(scope="session")
def result():
    return sample_run(size_mm=6.0)
