"""Calibrations as JSON: nothing is lost, and nothing unsound is taken."""

import json
import time

import numpy as np
import pytest
from calibration_samples import assert_same, sample_calibration, sparse_calibration
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp

from cbsr_qa.calibration.file.content import FIRST_VERSION, FORMAT, Entry, content_digest, latest_version
from cbsr_qa.calibration.file.hdf5 import read_calibration, stamp, write_calibration
from cbsr_qa.calibration.file.json import _entry, dataset, json_document, read_json_calibration
from cbsr_qa.domain.errors import CalibrationError


def _text(document):
    return json.dumps(document, ensure_ascii=False, allow_nan=False)


@pytest.mark.parametrize("make", [sample_calibration, sparse_calibration])
def test_every_field_comes_back_exactly_and_the_file_is_the_same_to_the_byte(tmp_path, make):
    path = tmp_path / "sensor.json"
    path.write_text(_text(json_document(make())), encoding="utf-8")
    back = read_json_calibration(path)
    assert_same(back, stamp(make()), "calibration")
    write_calibration(tmp_path / "one.h5", make())
    write_calibration(tmp_path / "other.h5", back)
    assert (tmp_path / "one.h5").read_bytes() == (tmp_path / "other.h5").read_bytes()
    assert json.loads(path.read_text())["digest"] == read_calibration(tmp_path / "one.h5").digest


_NUMBERS = hnp.arrays(
    np.float64, hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=8), elements=st.floats(width=64)
)
_VALUES = st.one_of(
    _NUMBERS.map(lambda a: np.asarray(np.where(np.isnan(a), np.nan, a))),
    _NUMBERS.map(
        lambda a: np.asarray(np.nan_to_num(a, nan=0, posinf=0, neginf=0).clip(-1e30, 1e30), dtype=np.float32)
    ),
    hnp.arrays(np.int64, hnp.array_shapes(max_dims=2, max_side=20)),
    hnp.arrays(np.bool_, hnp.array_shapes(min_dims=0, max_dims=2, max_side=20)),
    st.text(),
    st.lists(st.text()).map(tuple),
)


@given(_VALUES, st.integers(0, 40))
def test_any_value_keeps_its_digest(value, spelt_out):
    entry = Entry("1", value)
    told = json.loads(json.dumps(dataset(entry, spelt_out=spelt_out), allow_nan=False))
    assert content_digest({"x": _entry("x", told)}) == content_digest({"x": entry})


_HOSTILE = {
    "no JSON": ("{", "not JSON"),
    "a list": ("[]", "not a whole calibration"),
    "deep": ("[" * 100_000, "not JSON"),
    "huge integer": ('{"schema_version": 1' + "0" * 10_000 + "}", "not JSON"),
    "other format": ('{"format": "x", "datasets": {}}', "not a whole calibration"),
}


@pytest.mark.parametrize("what", _HOSTILE)
def test_what_is_no_calibration_is_refused_by_name(tmp_path, what):
    text, said = _HOSTILE[what]
    (tmp_path / "x.json").write_text(text)
    with pytest.raises(CalibrationError, match=said) as caught:
        read_json_calibration(tmp_path / "x.json")
    assert "x.json" in caught.value.reason


def _of(path, **changed):
    """Change keys of a dataset."""
    return lambda document: document["datasets"][path].update(changed)


def _first(path, value):
    """Change the first value of a dataset."""
    return lambda document: document["datasets"][path]["values"].__setitem__(0, value)


_EDITED = {
    "future": (
        lambda d: d.update(schema_version=99),
        f"schema_version is 99; this program knows versions {FIRST_VERSION[FORMAT]} to {latest_version(FORMAT)}",
    ),
    "of before": (lambda d: d.update(schema_version=4), "written to schema version 4, from before version 0.1.0"),
    "text for version": (lambda d: d.update(schema_version="2"), 'schema_version is "2"'),
    "true for version": (lambda d: d.update(schema_version=True), "schema_version is true"),
    "value": (_of("image/mask", values=[0.9]), "changed after it was written"),
    "unit": (_of("image/mask", units="mm"), "changed after it was written"),
    "gone": (lambda d: d["datasets"].pop("image/mask"), "changed after it was written"),
    "shape": (_of("reference/voltages", shape=[6, 5]), "reference/voltages: shape is a list; allowed: one of"),
    "negative": (_of("image/mask", shape=[-1]), "image/mask: shape is a list; allowed: a list of whole numbers"),
    "true in a shape": (_of("image/mask", shape=[True]), "image/mask: shape is a list; allowed: a list of whole"),
    "object for shape": (_of("image/mask", shape={}), "image/mask: shape is an object; allowed: a list of whole"),
    "text for shape": (_of("image/mask", shape=""), 'image/mask: shape is ""; allowed: a list of whole'),
    "axes": (_of("image/mask", shape=[1] * 99), "image/mask: shape is a list"),
    "claims": (_of("force/node", shape=[10**9, 10**9]), "force/node: shape is a list; allowed: one of"),
    "kind": (_of("image/mask", kind="O"), 'image/mask: kind is "O"; allowed: f8, f4, i8, u1, text'),
    "list for kind": (_of("image/mask", kind=["f8"]), "image/mask: kind is a list"),
    "null for units": (_of("image/mask", units=None), "image/mask: units is null; allowed: a text"),
    "text for number": (
        _of("image/mask", values=["x"]),
        r'image/mask: values\[0\] is "x"; allowed: a number or null',
    ),
    "false for number": (_first("image/mask", False), r"image/mask: values\[0\] is false; allowed: a number or null"),
    "object for values": (_of("image/mask", values={"0": 0.5}), "image/mask: values is an object; allowed: a list"),
    "text for values": (_of("identity/run", values="x"), 'identity/run: values is "x"; allowed: a list of values'),
    "number for text": (_of("identity/run", values=[1]), r"identity/run: values\[0\] is 1; allowed: a text"),
    "two texts for one": (
        _of("identity/run", values=["x", "y"]),
        "identity/run: shape is a list; allowed: that of 2",
    ),
    "half for whole": (_of("force/lattice/rows", values=[7.5]), r"values\[0\] is 7.5; allowed: a whole number"),
    "true for whole": (_of("force/lattice/rows", values=[True]), r"values\[0\] is true; allowed: a whole number"),
    "null for whole": (_of("force/lattice/rows", values=[None]), r"values\[0\] is null; allowed: a whole number"),
    "two for flag": (_first("force/fits", 2), "force/fits: values is 2; allowed: 0 and 1"),
    "true for flag": (_first("force/fits", True), r"force/fits: values\[0\] is true; allowed: a whole number"),
    "minus for flag": (_first("force/fits", -1), "force/fits: values is -1; allowed: 0 and 1"),
    "no base64": (_of("force/templates", base64="?"), "force/templates is not a dataset"),
    "list for base64": (_of("force/templates", base64=["?"]), "force/templates: base64 is a list; allowed: a text"),
    "both": (_of("image/mask", base64=""), "image/mask is not a dataset: it has the keys base64, kind, shape, units"),
    "another key": (_of("image/mask", unit="mm"), "image/mask is not a dataset: it has the keys kind, shape, unit"),
    "half a character": (_of("identity/serial", values=["\ud800"]), "identity/serial"),
    "not a dataset": (lambda d: d["datasets"].update({"image/mask": 3}), "image/mask is 3, not a dataset"),
    "deep": (lambda d: d["datasets"].update({"a/b/c/d/e/f": 3}), "'a/b/c/d/e/f' is not a name of a dataset"),
    "many": (lambda d: d["datasets"].update({str(n): 3 for n in range(2000)}), "more than 2000 datasets"),
}


@pytest.mark.parametrize("what", _EDITED)
def test_what_was_edited_is_refused_by_name(tmp_path, what):
    change, said = _EDITED[what]
    document = json_document(sample_calibration())
    change(document)
    (tmp_path / "x.json").write_text(json.dumps(document))
    with pytest.raises(CalibrationError, match=said):
        read_json_calibration(tmp_path / "x.json")


def test_a_file_that_is_not_there_or_too_large_is_refused(tmp_path, monkeypatch):
    with pytest.raises(CalibrationError, match="no such file"):
        read_json_calibration(tmp_path / "x.json")
    monkeypatch.setattr("cbsr_qa.calibration.file.hdf5._LARGEST_BYTES", 10)
    (tmp_path / "x.json").write_text(_text(json_document(sample_calibration())))
    with pytest.raises(CalibrationError, match="too large"):
        read_json_calibration(tmp_path / "x.json")


def test_a_file_of_many_parts_is_refused_before_they_are_read(tmp_path):
    """Nine megabytes: each part takes little to write, and a hundred times as much to read."""
    part = {"units": "1", "kind": "f8", "shape": [1], "values": [0]}
    document = {**json_document(sample_calibration()), "datasets": {f"a/{n}": part for n in range(150_000)}}
    (tmp_path / "x.json").write_text(json.dumps(document))
    begun_s = time.process_time()
    with pytest.raises(CalibrationError, match="JSON of more than 250000 values"):
        read_json_calibration(tmp_path / "x.json")
    assert time.process_time() - begun_s < 1.0
