"""The table of ``cbsr-qa scene explain``: aligned, within a page, and without numbers that mislead."""

import json
from datetime import date, datetime, time

import pytest

from cbsr_qa.cli.studies.scene import WIDTH, lines, plainly
from cbsr_qa.config import DocumentKind, shipped_names
from cbsr_qa.studies.scenes import Explained, ExplainedEffect


def _effect(name, perturbs, *, on=True, needs=(), each_ms=0.0, once_ms=0.0, does="It does something.", **parameters):
    cost_ms = each_ms + once_ms / 100
    return ExplainedEffect(name, on, needs, perturbs, cost_ms if on else 0.0, parameters, does, each_ms, once_ms)


def _explained(*effects, frame_ms=4.0):
    return Explained("mine", effects, ("the weather",), 100, frame_ms, 0.5, "a disc")


def _table(explained):
    return list(lines(explained))


def _row(explained, name):
    (row,) = (line for line in _table(explained) if f" {name} " in f"{line} ")
    return row


def test_effects_that_are_on_come_in_order_of_stage():
    """A scene may list the source before impedance, which a world comes to first."""
    effects = [_effect(f"e-{k}", stage) for k, stage in enumerate(("source", "impedance", "sheet", "impedance"))]
    said = [line.split()[:2] for line in _table(_explained(*effects))[2:6]]
    assert said[:2] == [["sheet", "e-2"], ["impedance", "e-1"]]
    assert said[2][0] == "e-3"  # of the stage above
    assert said[3] == ["source", "e-0"]


@pytest.mark.parametrize(("cost_ms", "said"), [(0.000061, "< 0.001"), (0.0012, "0.001"), (0.506, "0.506")])
def test_costs_have_three_decimals(cost_ms, said):
    row = _row(_explained(_effect("noise", "voltages", each_ms=cost_ms)), "noise")
    assert f"  {said}" in row


def test_the_largest_costs_have_bars_as_long_as_their_share():
    shares = {"none": 0.0, "fifth": 0.2, "half": 0.6, "all": 1.0, "more": 1.7}
    explained = _explained(*(_effect(name, "voltages", each_ms=4 * share) for name, share in shares.items()))
    assert [_row(explained, name).count("#") for name in shares] == [0, 1, 3, 5, 5]


@pytest.mark.parametrize("stage", ["sheet", "position", "geometry", "recording"])
def test_what_acts_once_is_no_cost_of_a_frame(stage):
    table = _explained(_effect("early", stage, each_ms=1.0, once_ms=21.5), _effect("later", "voltages", each_ms=1.0))
    assert "21.500 once" in _row(table, "early")
    assert "once" not in _row(table, "later")
    assert "#" not in _row(table, "early")
    assert any("once: in all" in line for line in _table(table))


def test_columns_stand_below_each_other_whatever_the_names():
    table = _explained(
        _effect("x", "voltages", each_ms=1.0, share=0.25),
        _effect("a-stranger-with-a-name-of-some-length", "voltages", each_ms=123.456, share=0.25),
        _effect("made-early", "sheet", once_ms=3.0, share=0.25),
    )
    rows = [line for line in _table(table) if "share = 0.25" in line]
    assert len({line.index("share = 0.25") for line in rows}) == 1
    assert _table(table)[1].index("parameters") == rows[0].index("share")


def test_what_does_not_fit_goes_on_below_itself():
    many = {f"parameter_{k}_mm": 1.5 for k in range(6)}
    table = _table(_explained(_effect("wordy", "voltages", needs=("one", "two"), **many)))
    rows = [line for line in table if "parameter_" in line or "needs one, two" in line]
    assert len(rows) > 2
    assert all(line[: rows[0].index("parameter_0")].isspace() for line in rows[1:])
    assert sum(line.count(" = 1.5") for line in table) == 6
    assert max(len(line) for line in table) <= WIDTH


def test_effects_that_are_off_have_their_names_and_what_they_do():
    table = _table(_explained(_effect("hum", "voltages", on=False, does="A sine on all readings. " * 6)))
    assert table[table.index("off") + 1].startswith("  hum  A sine on all")
    assert max(len(line) for line in table) <= WIDTH
    assert table.index("off") < table.index("not modelled")


def test_words_of_strangers_do_not_reach_the_terminal_as_commands():
    table = _table(_explained(_effect("odd", "voltages", on=False, does="red \x1b[31m\tand\x07")))
    assert any(line.startswith("  odd  red \ufffd[31m and\ufffd") for line in table)
    assert all(line.isprintable() for line in table)


def test_parameters_of_any_kind_that_toml_has_are_json():
    given = {"since": date(2026, 11, 21), "at": [time(8, 30)], "inner": {"when": datetime(2026, 1, 2, 3, 4)}, "n": 1}
    document = _effect("odd", "voltages", **given).document()
    assert json.loads(json.dumps(document))["parameters"] == {
        "since": "2026-11-21",
        "at": ["08:30:00"],
        "inner": {"when": "2026-01-02T03:04:00"},
        "n": 1,
    }


def test_costs_that_are_not_measured_are_not_printed():
    table = _table(_explained(_effect("noise", "voltages"), _effect("seat", "geometry"), frame_ms=None))
    assert "costs not measured" in table
    assert not any("once" in line or "0.001" in line or "#" in line for line in table)


def test_a_scene_without_effects_has_no_empty_table():
    table = _table(_explained(_effect("noise", "voltages", on=False)))
    assert table[:2] == ["scene mine: 0 of 1 effect on", "off"]


@pytest.mark.parametrize("name", shipped_names(DocumentKind.SCENE))
def test_shipped_scenes_fit_a_hundred_columns(name):
    from cbsr_qa.studies.scenes import explain_scene

    explained = explain_scene(name, measure=False)
    assert max(len(line) for line in lines(explained)) <= WIDTH


@pytest.mark.parametrize(
    ("value", "said"),
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
def test_parameters_are_printed_as_people_write_them(value, said):
    assert plainly(value) == said
