"""The JSON Schema of each command's document, and a document that must fit it."""

import json
from inspect import signature

from cbsr_qa.cli.command import commands
from cbsr_qa.cli.main import run_guarded


def printed(capsys, *arguments):
    assert run_guarded(["schema", *arguments]) == 0
    return capsys.readouterr().out


def test_every_command_that_prints_json_and_no_other_has_a_schema(capsys):
    """What takes --json is found in the commands themselves; a dry run is the second document of run."""
    with_json = {command.words for command in commands() if "as_json" in signature(command.run).parameters}
    assert {"run", "db status", "limits propose"} < with_json
    names = printed(capsys).splitlines()
    assert set(names) == with_json | {"dry run", "events", "channel", "stream messages"}
    assert len(names) == len(set(names))
    for name in names:
        whole = json.loads(printed(capsys, *name.split()))
        for each in whole.get("anyOf", [whole]):  # a calibration of a run and one from presses differ
            schema = whole["$defs"][each["$ref"].rpartition("/")[2]] if "$ref" in each else each
            assert schema["type"] == "object"
            assert set(schema.get("required", ())) <= set(schema["properties"])
        # Every object is described field by field: nothing is left as "any object".
        assert all(one.get("type") != "object" or one["properties"] for one in whole.get("$defs", {}).values()), name


def test_what_is_for_drawing_alone_is_in_no_schema(capsys):
    schema = json.loads(printed(capsys, "gauge"))
    assert "crossing" not in schema["$defs"]["MetricGauge"]["properties"]
    interval = schema["$defs"]["Component"]["properties"]["variance_interval"]["anyOf"][0]
    assert (interval["type"], interval["minItems"], interval["maxItems"]) == ("array", 2, 2)


def test_a_command_without_schema_is_refused_with_those_that_have_one(capsys):
    assert run_guarded(["schema", "gage"]) == 2
    assert "choose one of: analyse, batch model, calibrate, calibration apply," in capsys.readouterr().err


def test_a_group_of_one_command_needs_no_second_word(capsys):
    assert json.loads(printed(capsys, "limits")) == json.loads(printed(capsys, "limits", "propose"))
    assert run_guarded(["schema", "calibration"]) == 2
    assert "choose one of: calibration apply, calibration export," in capsys.readouterr().err
