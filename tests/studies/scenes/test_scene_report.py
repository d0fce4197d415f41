"""What ``cbsr-qa scene`` prints: effects in order with their costs, and what was recorded."""

from datetime import date, datetime, time

import pytest

from cbsr_qa.report import json_document, terminal_lines
from cbsr_qa.studies.scenes import Explained, explained_outcome
from cbsr_qa.studies.scenes.explain import ExplainedEffect


def _effect(name, perturbs, *, on=True, needs=(), each_ms=0.0, once_ms=0.0, does="It does something.", **parameters):
    cost_ms = each_ms + once_ms / 100
    return ExplainedEffect(name, on, needs, perturbs, cost_ms if on else 0.0, parameters, does, each_ms, once_ms)


def _explained(*effects, frame_ms=4.0):
    return Explained("mine", effects, ("the weather",), 100, frame_ms, 0.5, "a disc")


def _printed(explained):
    outcome = explained_outcome(explained)
    return list(terminal_lines(outcome.page, outcome.sections))


def _row(explained, name):
    (row,) = (line for line in _printed(explained) if f" {name} " in f"{line} ")
    return row


def test_effects_that_are_on_come_in_order_of_stage():
    """A scene may list the source before impedance, which a world comes to first."""
    effects = [_effect(f"e-{k}", stage) for k, stage in enumerate(("source", "impedance", "sheet", "impedance"))]
    printed = _printed(_explained(*effects))
    first = next(number for number, line in enumerate(printed) if line.split()[:1] == ["sheet"])
    names = [line.split()[:2] for line in printed[first : first + 4]]
    assert names[:2] == [["sheet", "e-2"], ["impedance", "e-1"]]
    assert names[2][0] == "e-3"  # of the stage above
    assert names[3] == ["source", "e-0"]


@pytest.mark.parametrize("stage", ["sheet", "position", "geometry", "recording"])
def test_what_acts_once_is_no_cost_of_a_frame(stage):
    explained = _explained(
        _effect("early", stage, each_ms=1.0, once_ms=21.5), _effect("later", "voltages", each_ms=1.0)
    )
    assert "21.500  once" in _row(explained, "early")
    assert "#" not in _row(explained, "early")
    assert "once" not in _row(explained, "later")
    assert any("Once: in all" in line for line in _printed(explained))


def test_costs_that_are_not_measured_are_not_printed():
    printed = _printed(_explained(_effect("noise", "voltages"), _effect("seat", "geometry"), frame_ms=None))
    assert "costs not measured" in printed[0]
    assert not any("once" in line or "0.001" in line or "#" in line for line in printed)


def test_words_of_strangers_do_not_reach_the_terminal_as_commands():
    printed = _printed(_explained(_effect("odd", "voltages", on=False, does="red \x1b[31m\tand\x07")))
    assert any("odd" in line for line in printed)
    assert all(line.isprintable() for line in printed)


def test_parameters_of_any_kind_that_toml_has_are_json():
    given = {"since": date(2026, 11, 21), "at": [time(8, 30)], "inner": {"when": datetime(2026, 1, 2, 3, 4)}, "n": 1}
    (effect,) = json_document(_explained(_effect("odd", "voltages", **given)))["effects"]
    assert effect["parameters"] == {
        "since": "2026-11-21",
        "at": ["08:30:00"],
        "inner": {"when": "2026-01-02T03:04:00"},
        "n": 1,
    }
