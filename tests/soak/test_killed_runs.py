"""Runs killed with SIGKILL once or twice at random moments, resumed, and compared bit for bit.

Two hundred with a fixed order of presses, and forty that decide after each press which one is next, on the simulated
bench and on the emulated one.
"""

import os
import random

import pytest
from command import cbsr_qa, document
from killing import ADAPTIVE, ADAPTIVE_PLANE, BEGIN, UNEVEN, came_of, trial, write_files

DECIDING = int(os.environ.get("CBSR_QA_SOAK_DECIDING", "40"))
EMULATED = int(os.environ.get("CBSR_QA_SOAK_EMULATED", "40"))
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


@pytest.fixture(scope="module")
def deciding(tmp_path_factory):
    """A run that decides, and was left alone."""
    folder = tmp_path_factory.mktemp("deciding")
    write_files(folder, recipe=ADAPTIVE, more_effects=UNEVEN)
    run = document(cbsr_qa(folder, *BEGIN, "--serial", "whole"))
    return came_of(folder, run["run"])


@pytest.mark.parametrize("number", range(DECIDING))
def test_a_killed_run_that_decides_decides_the_same_and_comes_to_the_same(deciding, tmp_path, number):
    write_files(tmp_path, recipe=ADAPTIVE, more_effects=UNEVEN)
    source = random.Random(f"{SEED}/deciding/{number}")
    came = trial(tmp_path, "S-1", deciding, source, kills=source.choice([1, 1, 2]), documents=(300, 200))
    assert str(came.record.end) == "finished"
    assert came.record.decisions


@pytest.fixture(scope="module", params=[False, True], ids=["simulated", "emulated"])
def planar(request, tmp_path_factory):
    """Station's kind, and a run over a plane that decides, and was left alone."""
    folder = tmp_path_factory.mktemp("planar")
    write_files(folder, recipe=ADAPTIVE_PLANE, more_effects=UNEVEN, emulated=request.param)
    run = document(cbsr_qa(folder, *BEGIN, "--serial", "whole", limit_s=900))
    return request.param, came_of(folder, run["run"])


@pytest.mark.parametrize("number", range(EMULATED))
def test_a_killed_run_over_a_plane_decides_the_same_and_comes_to_the_same(planar, tmp_path, number):
    emulated, whole = planar
    write_files(tmp_path, recipe=ADAPTIVE_PLANE, more_effects=UNEVEN, emulated=emulated)
    source = random.Random(f"{SEED}/planar/{number}")
    came = trial(tmp_path, "S-1", whole, source, kills=source.choice([1, 1, 2]), documents=(230, 150), limit_s=900)
    assert str(came.record.end) == "finished"
    assert came.record.decisions
