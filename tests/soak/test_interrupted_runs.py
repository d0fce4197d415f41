"""A hundred runs, each struck with SIGKILL or SIGTERM up to four times, also while its result is computed.

``-o junit_family=xunit1 --junitxml=FILE`` says how often each was struck.
"""

import os
import random

import pytest
from killing import interrupted, left_alone

TRIALS = int(os.environ.get("CBSR_QA_SOAK_TRIALS", "100"))
SEED = int(os.environ.get("CBSR_QA_SOAK_SEED", "0"))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return left_alone(tmp_path_factory.mktemp("whole"))


@pytest.mark.parametrize("number", range(TRIALS))
def test_an_interrupted_run_gets_its_result(whole, tmp_path, record_property, number):
    record_property("struck", interrupted(tmp_path, *whole, random.Random(f"{SEED}/{number}")))
