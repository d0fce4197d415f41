"""Calibrations as JSON: nothing is lost, and nothing unsound is taken."""

import json

import numpy as np
import pytest
from calibration_samples import assert_same, old_calibration, sample_calibration, sparse_calibration
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp

from cbsr_qa.calibration.file.content import SCHEMA_VERSION, Entry, content_digest
from cbsr_qa.calibration.file.hdf5 import read_calibration, stamp, write_calibration
from cbsr_qa.calibration.file.json import _entry, dataset, json_document, read_json_calibration
from cbsr_qa.domain import CalibrationError


def _text(document):
    return json.dumps(document, ensure_ascii=False, allow_nan=False)


@pytest.mark.parametrize("make", [sample_calibration, sparse_calibration, old_calibration])
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


_EDITED = {
    "future": (lambda d: d.update(schema_version=99), f"version 99.*up to {SCHEMA_VERSION}"),
    "boolean version": (lambda d: d.update(schema_version="2"), "version '2'"),
    "value": (lambda d: d["datasets"]["image/mask"].update(values=[0.9]), "changed after it was written"),
    "unit": (lambda d: d["datasets"]["image/mask"].update(units="mm"), "changed after it was written"),
    "gone": (lambda d: d["datasets"].pop("image/mask"), "changed after it was written"),
    "shape": (lambda d: d["datasets"]["reference/voltages"].update(shape=[6, 5]), "reference/voltages is not a data"),
    "negative": (lambda d: d["datasets"]["image/mask"].update(shape=[-1]), "image/mask states no units or no shape"),
    "claims": (lambda d: d["datasets"]["force/node"].update(shape=[10**9, 10**9]), "force/node is not a dataset"),
    "kind": (lambda d: d["datasets"]["image/mask"].update(kind="O"), "image/mask is not a dataset"),
    "text for number": (lambda d: d["datasets"]["image/mask"].update(values=["x"]), "image/mask is not a dataset"),
    "number for text": (lambda d: d["datasets"]["identity/run"].update(values=[1]), "a text is expected"),
    "half for whole": (lambda d: d["datasets"]["force/lattice/rows"].update(values=[7.5]), "whole numbers"),
    "two for flag": (lambda d: d["datasets"]["force/fits"]["values"].__setitem__(0, 2), "0 or 1 is expected"),
    "no base64": (lambda d: d["datasets"]["force/templates"].update(base64="?"), "force/templates is not a dataset"),
    "half a character": (lambda d: d["datasets"]["identity/serial"].update(values=["\ud800"]), "identity/serial"),
    "not a dataset": (lambda d: d["datasets"].update({"image/mask": 3}), "image/mask is not a dataset"),
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
