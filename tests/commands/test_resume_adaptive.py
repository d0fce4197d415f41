"""A run that decides which press is next, interrupted: it decides as it would have."""

import random

import pytest
from command import cbsr_qa
from killing import ADAPTIVE, BEGIN, came_of, latest_run, trial, write_files
from made_once import made_once


@pytest.fixture(scope="module")
def whole():
    """A run that was left alone."""

    def make(folder):
        write_files(folder, recipe=ADAPTIVE)
        cbsr_qa(folder, *BEGIN, "--serial", "whole")

    folder = made_once("deciding run left alone", make)
    return came_of(folder, latest_run(folder, "whole"))


def test_it_presses_what_it_decided_and_ends_as_it_decided(whole):
    decisions, (_, phase) = whole.record.decisions, whole.record.phases
    pressed = [load.index for load in sorted(phase.loads, key=lambda load: load.press_start_s)]
    assert [made.load for made in decisions] == [*pressed, None]
    assert [made.pressed for made in decisions] == list(range(len(pressed) + 1))
    assert [made.why for made in decisions[:4]] == ["start"] * 4
    assert decisions[-1].why in ("target", "most presses")
    assert 4 <= len(pressed) <= 7


@pytest.mark.rest
@pytest.mark.parametrize("seed", range(4))
def test_killed_and_resumed_it_decides_the_same_and_comes_to_the_same_in_every_bit(whole, tmp_path, seed):
    write_files(tmp_path, recipe=ADAPTIVE)
    came = trial(tmp_path, "S-1", whole, random.Random(f"deciding {seed}"), kills=1 + seed % 2)
    assert str(came.record.end) == "finished"
