"""What ``cbsr-qa scene`` prints: effects in order with their costs, and what was recorded."""

from datetime import date, datetime, time

import pytest

from cbsr_qa.config.documents import DocumentKind, list_shipped
from cbsr_qa.report.document import json_document
from cbsr_qa.report.terminal import terminal_lines
from cbsr_qa.studies.scenes.explain import Explained, ExplainedEffect, explain_scene
from cbsr_qa.studies.scenes.report import explain_outcome, plainly


def _effect(name, perturbs, *, on=True, needs=(), each_ms=0.0, once_ms=0.0, does="It does something.", **parameters):
    cost_ms = each_ms + once_ms / 100
    return ExplainedEffect(name, on, needs, perturbs, cost_ms if on else 0.0, parameters, does, each_ms, once_ms)


def _explained(*effects, frame_ms=4.0):
    return Explained("mine", effects, ("the weather",), 100, frame_ms, 0.5, "a disc")


def _printed(explained):
    outcome = explain_outcome(explained)
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


@pytest.mark.parametrize(("cost_ms", "shown"), [(0.000061, "< 0.001"), (0.0012, "0.001"), (0.506, "0.506")])
def test_costs_have_three_decimals(cost_ms, shown):
    assert f"  {shown}" in _row(_explained(_effect("noise", "voltages", each_ms=cost_ms)), "noise")


def test_the_largest_costs_have_bars_as_long_as_their_share():
    shares = {"none": 0.0, "fifth": 0.2, "half": 0.6, "all": 1.0, "more": 1.7}
    explained = _explained(*(_effect(name, "voltages", each_ms=4 * share) for name, share in shares.items()))
    assert [_row(explained, name).count("#") for name in shares] == [0, 1, 3, 5, 5]


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


def test_a_scene_without_effects_has_no_empty_table():
    printed = _printed(_explained(_effect("noise", "voltages", on=False)))
    assert "0 of 1 effect on" in printed[0]
    assert "On" not in printed


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


@pytest.mark.parametrize("name", list_shipped(DocumentKind.SCENE))
def test_shipped_scenes_fit_a_hundred_columns(name):
    assert max(map(len, _printed(explain_scene(name, measure=False)))) <= 100


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (0.05, "0.05"),
        (5e6, "5e6"),
        (1e10, "1e10"),
        (1e-12, "1e-12"),
        (1234567.0, "1234567.0"),
        (100.0, "100"),
        (0.123456789, "0.123456789"),
        (True, "true"),
        ("punch", '"punch"'),
        ("größer", '"größer"'),
        ("a\x1b[31m\nb", r'"a\u001b[31m\nb"'),
        (date(2026, 11, 21), "2026-11-21"),
        ([9, 10], "[9, 10]"),
        ([0.5, 1e-6], "[0.5, 1e-6]"),
        ({"a": 1.0}, "{a = 1}"),
    ],
)
def test_parameters_are_printed_as_people_write_them(value, shown):
    assert plainly(value) == shown
