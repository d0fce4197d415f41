"""JSON that others wrote: what two programs could read differently is refused, and says why."""

import json

import pytest

from cbsr_qa.system.json_text import parse_json


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ('{"a": 1, "a": 2}', "the key 'a' appears twice in one object"),
        ('{"b": [{"a": {"c": 1, "d": 0, "c": 1}}]}', "the key 'c' appears twice"),
        ('{"a": 1, "\\u0061": 2}', "the key 'a' appears twice"),
        (f'{{"{"k" * 1000}": 1, "{"k" * 1000}": 2}}', "the key 'k{60}' appears twice"),
        ("[NaN]", "NaN is not a number in JSON"),
        ('{"a": -Infinity}', "-Infinity is not a number in JSON"),
        ("[1e400]", "the number 1e400 is too large"),
        ("[-1" + "0" * 5000 + "]", "the number -10{58} is too large"),
        ("[" * 100_000, "nested more than 64 deep"),
        ('{"a":' * 100_000, "nested more than 64 deep"),
        ("[" * 65 + "]" * 65, "nested more than 64 deep"),
        ("", "Expecting value"),
        ('["' + "[" * 100 + "", "Unterminated string"),
        (b'["\xff"]', "can't decode"),
        ('{"a": 1}'.encode("utf-16"), "can't decode"),
    ],
)
def test_what_could_be_read_in_two_ways_is_refused(text, why):
    with pytest.raises(ValueError, match=why):
        parse_json(text)


@pytest.mark.parametrize(
    "value",
    [
        {"a": [{"a": 1}, {"a": 2.5e-300}], "b": {"a": None, "ü": '[[[\\"[[' * 20}},
        [[1]] * 100,
        json.loads("[" * 64 + "1" + "]" * 64),
        ['"' * 100, "\\" * 101, {"[": "{"}] * 70,
        2**128,
    ],
)
def test_honest_json_is_read_as_it_is(value):
    for text in (json.dumps(value), json.dumps(value, ensure_ascii=False).encode()):
        assert parse_json(text) == value
