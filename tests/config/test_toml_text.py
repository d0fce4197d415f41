"""TOML text reads back as the document it was written from."""

import math
import tomllib

import numpy as np
import pytest
from hypothesis import example, given, strategies as st

from cbsr_qa.config.documents import DocumentKind, open_document
from cbsr_qa.config.text import one_line, toml_document, toml_value

texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
keys = texts | st.sampled_from(["a", "b c", "", ".", "é", '"', "a-b_1", "\x00", "\x7f", "😀", "1.5", "true"])
plain = texts | st.integers(-(2**63), 2**63 - 1) | st.booleans() | st.floats(allow_nan=False)
values = st.recursive(
    plain, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(keys, inner, max_size=3), max_leaves=12
)
documents = st.dictionaries(keys, values, max_size=4)


@given(documents, st.lists(texts, max_size=2))
@example({"a": [{"b": [{"c": {"d": [1.0, {"e": []}]}}]}, {}]}, [])
@example({"table": {"empty": {}, "deep": {"deeper": {"x": 1}}}, "after": 2}, ["one\ntwo = 3"])
@example({"x": 1e300, "y": math.inf, "z": [5e-324, -0.0, 1e16]}, [])
def test_what_was_written_is_read(document, comments):
    back = tomllib.loads(toml_document(document, comments))
    assert back == document
    assert repr(back) == repr(_ordered_as(document, back))  # 1 is no 1.0, and -0.0 no 0.0


def _ordered_as(document, like):
    """The same document with keys in another's order: tables come after plain keys."""
    if isinstance(document, dict):
        return {key: _ordered_as(document[key], like[key]) for key in like}
    if isinstance(document, list):
        return [_ordered_as(one, other) for one, other in zip(document, like, strict=True)]
    return document


@given(plain)
def test_tuples_and_numbers_of_numpy_are_written_too(value):
    assert tomllib.loads(f"x = {toml_value((value, value))}") == {"x": [value, value]}
    if isinstance(value, float):
        assert toml_value(np.float64(value)) == toml_value(value)


@pytest.mark.parametrize("value", [None, [None], {"a": None}, 1j, {1, 2}])
def test_what_toml_has_no_value_for_is_not_written(value):
    with pytest.raises(TypeError, match="TOML has no value"):
        toml_document({"key": value})


@given(texts)
def test_a_comment_is_one_line_whatever_is_in_it(text):
    assert len(one_line(text)) == len(text)
    assert tomllib.loads(toml_document({"a": 1}, [text])) == {"a": 1}


@pytest.mark.parametrize("name", ["campaign", "nine-locations"])
def test_a_shipped_recipe_survives(name):
    recipe = dict(open_document(DocumentKind.RECIPE, name).data)
    assert tomllib.loads(toml_document(recipe)) == recipe
