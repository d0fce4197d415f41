"""The JSON Schema of each command's document, and a document that must fit it."""

import json

import pytest

from cbsr_qa.cli import guarded
from cbsr_qa.cli.schema import results


def printed(capsys, *arguments):
    assert guarded(["schema", *arguments]) == 0
    return capsys.readouterr().out


def test_every_command_with_a_schema_is_listed_and_has_one(capsys):
    names = printed(capsys).splitlines()
    assert names == list(results())
    for name in names:
        schema = json.loads(printed(capsys, *name.split()))
        assert schema["type"] == "object"
        assert set(schema.get("required", ())) <= set(schema["properties"])


def test_what_is_for_drawing_alone_is_in_no_schema(capsys):
    schema = json.loads(printed(capsys, "gauge"))
    assert "crossing" not in schema["$defs"]["MetricGauge"]["properties"]
    interval = schema["$defs"]["Component"]["properties"]["variance_interval"]["anyOf"][0]
    assert (interval["type"], interval["minItems"], interval["maxItems"]) == ("array", 2, 2)


def test_a_command_without_schema_is_refused_with_those_that_have_one(capsys):
    assert guarded(["schema", "gage"]) == 2
    assert f"choose one of: {', '.join(results())}" in capsys.readouterr().err


@pytest.mark.parametrize("name", results())
def test_keys_are_said_to_be_closed_or_open_alike(capsys, name):
    """Every object of a document is described field by field: nothing is left as "any object"."""
    schema = json.loads(printed(capsys, *name.split()))
    for definition in schema.get("$defs", {}).values():
        assert definition.get("type") != "object" or definition["properties"]
