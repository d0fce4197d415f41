"""Two hundred runs, each killed with SIGKILL once or twice at random moments, resumed, and compared bit for bit."""

import os
import random

import pytest
from command import cbsr_qa, document
from killing import BEGIN, came_of, trial, write_files

TRIALS = int(os.environ.get("CBSR_QA_SOAK_TRIALS", "200"))
SEED = int(os.environ.get("CBSR_QA_SOAK_SEED", "0"))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A run that was left alone."""
    folder = tmp_path_factory.mktemp("whole")
    write_files(folder)
    run = document(cbsr_qa(folder, *BEGIN, "--serial", "whole"))
    return came_of(folder, run["run"])


@pytest.mark.parametrize("number", range(TRIALS))
def test_a_killed_run_comes_to_the_same(whole, tmp_path, number):
    write_files(tmp_path)
    source = random.Random(f"{SEED}/{number}")
    came = trial(tmp_path, "S-1", whole, source, kills=source.choice([1, 1, 2]))
    assert str(came.record.end) == "finished"
