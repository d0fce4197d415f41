"""A run that decides which press is next, interrupted: it decides as it would have, and as its stored data say."""

import random

import pytest
from command import cbsr_qa
from killing import ADAPTIVE, BEGIN, UNEVEN, came_of, latest_run, trial, write_files
from made_once import made_once

from cbsr_qa.config.merging import restore
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.station.decisions import PressDecisions
from cbsr_qa.station.setup import plan_of
from cbsr_qa.store.opening import open_store


@pytest.fixture(scope="module")
def whole():
    """A folder with a run that was left alone, and what came of it."""

    def make(folder):
        write_files(folder, recipe=ADAPTIVE, more_effects=UNEVEN)
        cbsr_qa(folder, *BEGIN, "--serial", "whole")

    folder = made_once("deciding run left alone", make)
    return folder, came_of(folder, latest_run(folder, "whole"))


def decide_again(folder, came):
    """Return the stored decisions of a run, and those that its data lead to."""
    with open_store(f"sqlite:///{folder}/var/cbsr-qa.db", create=False) as store:
        configuration = restore(store.runs.read_configuration(came.record.identity.run))
    plugins = discover()
    decisions = PressDecisions.from_configuration(configuration, plan_of(configuration, plugins), plugins)
    return zip(*decisions.decide_again(came.record), strict=True)


def test_it_presses_what_it_decided_and_ends_as_it_decided(whole):
    record = whole[1].record
    decisions, (_, phase) = record.decisions, record.phases
    pressed = [load.index for load in sorted(phase.loads, key=lambda load: load.press_start_s)]
    assert [made.load for made in decisions] == [*pressed, None]
    assert [made.pressed for made in decisions] == list(range(len(pressed) + 1))
    assert [made.why for made in decisions] == ["start"] * 4 + ["error"] * 3 + ["most presses"]
    assert decisions[-1].expected_N < decisions[3].expected_N


def test_the_stored_run_leads_to_the_same_decisions_again(whole):
    stored, again = decide_again(*whole)
    assert stored == again


@pytest.mark.rest
@pytest.mark.parametrize("seed", range(4))
def test_killed_and_resumed_it_decides_the_same_and_comes_to_the_same_in_every_bit(whole, tmp_path, seed):
    write_files(tmp_path, recipe=ADAPTIVE, more_effects=UNEVEN)
    came = trial(tmp_path, "S-1", whole[1], random.Random(f"deciding {seed}"), kills=1 + seed % 2)
    assert str(came.record.end) == "finished"
    stored, again = decide_again(tmp_path, came)
    assert stored == again
