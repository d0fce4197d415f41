"""A run that decides which press is next, interrupted: it decides as it would have, and as its stored data say."""

import json
import random
from dataclasses import replace
from types import SimpleNamespace

import pytest
from command import cbsr_qa
from killing import ADAPTIVE, ADAPTIVE_PLANE, BEGIN, UNEVEN, came_of, latest_run, trial, write_files
from made_once import made_once

from cbsr_qa.app.run.decisions import compare_decisions
from cbsr_qa.app.run.outcome import _describe_decisions
from cbsr_qa.config.merging import restore
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.store.opening import open_store
from cbsr_qa.web.live_run import LiveRun
from cbsr_qa_plugins.sections.time_and_accuracy import _draw_decisions


@pytest.fixture(scope="module")
def whole():
    """A folder with a run that was left alone, and what came of it."""

    def make(folder):
        write_files(folder, recipe=ADAPTIVE, more_effects=UNEVEN)
        (folder / "outcome.json").write_text(cbsr_qa(folder, *BEGIN, "--serial", "whole").stdout)

    folder = made_once("deciding run left alone", make)
    return folder, came_of(folder, latest_run(folder, "whole"))


def differing(folder, record):
    """What differs where the decisions of a stored run are made again."""
    with open_store(f"sqlite:///{folder}/var/cbsr-qa.db", create=False) as store:
        configuration = restore(store.runs.read_configuration(record.identity.run))
    return list(compare_decisions(record, configuration, discover()))


def test_it_presses_what_it_decided_and_ends_as_it_decided(whole):
    record = whole[1].record
    decisions, (_, phase) = record.decisions, record.phases
    pressed = [load.index for load in sorted(phase.loads, key=lambda load: load.press_start_s)]
    assert [made.load for made in decisions] == [*pressed, None]
    assert [made.pressed for made in decisions] == list(range(len(pressed) + 1))
    assert [made.why for made in decisions] == ["start"] * 4 + ["error"] * 3 + ["most presses"]
    assert decisions[-1].expected_N < decisions[3].expected_N


def test_the_stored_run_leads_to_the_same_decisions_again(whole):
    folder, came = whole
    assert differing(folder, came.record) == []
    made = list(came.record.decisions)
    made[5] = replace(made[5], label="A0", load=0)
    (said,) = differing(folder, replace(came.record, decisions=tuple(made)))
    assert said.startswith("after 5 presses of phase 'chosen places' the run decided A0 (error; ")


def test_the_outcome_has_the_error_as_it_fell(whole):
    folder, came = whole
    said = json.loads((folder / "outcome.json").read_text())
    known = [made for made in came.record.decisions if made.expected_N is not None]
    assert [minutes for minutes, _ in said["error_by_minute"]] == [round(made.time_s / 60, 3) for made in known]
    assert [error for _, error in said["error_by_minute"]] == pytest.approx([m.expected_N for m in known], rel=1e-3)
    assert said["presses"] == 8
    assert said["station_minutes"] == pytest.approx(said["station_s"] / 60, abs=1e-3)
    (end,) = said["decided"]
    assert (end["phase"], end["presses"], end["end"]) == ("chosen places", 7, "most presses")
    ((_, ended), (_, fell)) = _describe_decisions(came.record)
    assert ended.startswith("7 chosen one by one; no more presses were allowed: ")
    assert fell.count(" N at ") == len(known)


def test_the_report_draws_the_error_as_it_fell(whole):
    figure, words = _draw_decisions(SimpleNamespace(record=whole[1].record))
    assert "<svg" in figure.svg
    assert words.text.startswith("After 7 presses of 'chosen places' no more presses were allowed: ")


def test_who_watches_sees_the_error_fall(whole):
    folder, came = whole
    with open_store(f"sqlite:///{folder}/var/cbsr-qa.db", create=False) as store:
        live = LiveRun(store, discover(), came.record.identity.run)
        live.update()
        view = live.view("")
    assert len(view.error_N) == len([made for made in came.record.decisions if made.expected_N is not None])
    assert (view.loads_done, view.loads_planned) == (8, 8)


@pytest.mark.rest
@pytest.mark.parametrize("seed", range(4))
def test_killed_and_resumed_it_decides_the_same_and_comes_to_the_same_in_every_bit(whole, tmp_path, seed):
    write_files(tmp_path, recipe=ADAPTIVE, more_effects=UNEVEN)
    came = trial(
        tmp_path, "S-1", whole[1], random.Random(f"deciding {seed}"), kills=1 + seed % 2, documents=(300, 200)
    )
    assert str(came.record.end) == "finished"
    assert differing(tmp_path, came.record) == []


@pytest.fixture(scope="module")
def planar():
    """What came of a run over a plane, with the head just clear of it, that was left alone."""

    def make(folder):
        write_files(folder, recipe=ADAPTIVE_PLANE, more_effects=UNEVEN)
        cbsr_qa(folder, *BEGIN, "--serial", "whole")

    folder = made_once("deciding run over a plane left alone", make)
    return came_of(folder, latest_run(folder, "whole"))


@pytest.mark.rest
@pytest.mark.parametrize("seed", range(3))
def test_a_plane_that_is_touched_again_and_the_height_of_travel_change_no_bit(planar, tmp_path, seed):
    write_files(tmp_path, recipe=ADAPTIVE_PLANE, more_effects=UNEVEN)
    source = random.Random(f"planar {seed}")
    came = trial(tmp_path, "S-1", planar, source, kills=1 + seed % 2, documents=(230, 150))
    assert str(came.record.end) == "finished"
