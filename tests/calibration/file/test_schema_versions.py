"""Versions of the calibration file: those from before 0.1.0 are refused, and a later one only adds entries."""

import hashlib
import json
from dataclasses import dataclass, fields, replace
from typing import Annotated

import numpy as np
import pytest
from calibration_samples import INDENTER, LOAD_CELL, edited, forged, sample_calibration

from cbsr_qa.calibration.file import content, entries
from cbsr_qa.calibration.file.content import FIRST_VERSION, FORMAT, PRESS_FORMAT, latest_version
from cbsr_qa.calibration.file.hdf5 import read_calibration, stamp, verify_calibration_file, write_calibration
from cbsr_qa.calibration.file.json import json_document, read_json_calibration
from cbsr_qa.domain.errors import LAST_UNRELEASED, CalibrationError
from cbsr_qa.domain.kept import Kept
from cbsr_qa.domain.plan.standards import ReferenceStandard
from cbsr_qa.domain.results.calibration import BatchUse, Calibration
from cbsr_qa.domain.results.press_calibration import PressCalibration
from cbsr_qa.domain.sensor.sensor_type import Parameter

FIRST = FIRST_VERSION[FORMAT]
KNOWN = latest_version(FORMAT)
LATER = KNOWN + 1


@dataclass(frozen=True, repr=False)
class LaterCalibration(Calibration):
    """As a later version of the program knows it."""

    humidity: Annotated[float | None, Kept("identity/humidity", "%", since=LATER)] = None


def later_sample(humidity):
    sample = sample_calibration()
    return LaterCalibration(
        **{field.name: getattr(sample, field.name) for field in fields(sample)}, humidity=humidity
    )


@pytest.fixture
def later(monkeypatch):
    monkeypatch.setattr(content, "_KINDS", {FORMAT: LaterCalibration, PRESS_FORMAT: PressCalibration})
    monkeypatch.setattr(entries, "Calibration", LaterCalibration)


@pytest.mark.parametrize("version", [-1, 0, 1, 2, 3, 4])
def test_a_file_of_before_the_first_version_is_refused_and_stays_as_it_is(issued, version):
    with edited(issued) as file:
        file.attrs["schema_version"] = np.int64(version)
    before = hashlib.sha256(issued.read_bytes()).hexdigest()
    said = rf"written to schema version {version}, from before version 0\.1\.0, which this program does not read"
    for read in (read_calibration, verify_calibration_file):
        with pytest.raises(CalibrationError, match=said) as caught:
            read(issued)
        assert f"commit {LAST_UNRELEASED} of cbsr-qa still reads this one" in caught.value.remedy
        assert caught.value.exit_code == 2
    assert hashlib.sha256(issued.read_bytes()).hexdigest() == before


def test_what_is_issued_now_is_of_the_first_version(issued):
    assert verify_calibration_file(issued).schema_version == FIRST


def test_reference_standards_come_back_and_raise_the_version(tmp_path):
    path, sample = tmp_path / "traced.h5", replace(sample_calibration(), standards=(LOAD_CELL, INDENTER))
    write_calibration(path, sample)
    assert verify_calibration_file(path).schema_version == 6
    assert read_calibration(path).standards == (LOAD_CELL, INDENTER)
    (tmp_path / "traced.json").write_text(json.dumps(json_document(stamp(sample))))
    assert read_json_calibration(tmp_path / "traced.json").standards == (LOAD_CELL, INDENTER)


def test_what_a_map_owes_to_a_batch_comes_back_and_raises_the_version(tmp_path):
    use, sample = BatchUse("d" * 64, True, 0.43, 0.25), sample_calibration()
    path, sample = tmp_path / "batch.h5", replace(sample, force=replace(sample.force, batch=use))
    write_calibration(path, sample)
    assert verify_calibration_file(path).schema_version == 7
    assert read_calibration(path).force.batch == use
    (tmp_path / "batch.json").write_text(json.dumps(json_document(stamp(sample))))
    assert read_json_calibration(tmp_path / "batch.json").force.batch == use


def test_what_a_certificate_covers_comes_back_and_raises_the_version(tmp_path):
    stage = ReferenceStandard(
        "stage", "S-1", "D-K-1", "2026-03-02", "2027-03-31", 0.02, 2.0, "mm", 0.01, None, 0.0, 250.0
    )
    warmth = Parameter(0.004, 0.001, "measured in a climate chamber")
    sample = replace(sample_calibration(), standards=(LOAD_CELL, stage), response_per_C=warmth)
    write_calibration(tmp_path / "full.h5", sample)
    assert verify_calibration_file(tmp_path / "full.h5").schema_version == KNOWN == 8
    (tmp_path / "full.json").write_text(json.dumps(json_document(stamp(sample))))
    for read in (read_calibration(tmp_path / "full.h5"), read_json_calibration(tmp_path / "full.json")):
        assert (read.standards, read.response_per_C) == ((LOAD_CELL, stage), warmth)


@pytest.mark.usefixtures("later")
def test_a_field_that_is_added_later_comes_back_and_raises_the_version(tmp_path):
    path = tmp_path / "later.h5"
    write_calibration(path, later_sample(55.0))
    assert verify_calibration_file(path).schema_version == LATER
    assert read_calibration(path).humidity == 55.0


@pytest.mark.usefixtures("later")
def test_a_file_without_the_field_keeps_version_digest_and_bytes(issued, tmp_path):
    before = read_calibration(issued)
    assert before.humidity is None
    assert write_calibration(tmp_path / "again.h5", before) == before.digest
    assert (tmp_path / "again.h5").read_bytes() == issued.read_bytes()
    assert verify_calibration_file(issued).schema_version == FIRST
    assert stamp(later_sample(None)).record_digest == stamp(sample_calibration()).record_digest


def test_a_file_of_a_later_version_is_refused_by_this_one(tmp_path, monkeypatch):
    path = tmp_path / "later.h5"
    with monkeypatch.context() as patched:
        patched.setattr(content, "_KINDS", {FORMAT: LaterCalibration, PRESS_FORMAT: PressCalibration})
        write_calibration(path, later_sample(55.0))
    with pytest.raises(CalibrationError, match=f"schema version {LATER}; this program knows versions up to {KNOWN}"):
        read_calibration(path)


def test_a_version_that_does_not_fit_the_content_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "later.h5"
    write_calibration(path, sample_calibration())
    with monkeypatch.context() as patched:
        patched.setattr(content, "_KINDS", {FORMAT: LaterCalibration, PRESS_FORMAT: PressCalibration})
        with forged(path) as file:
            file.attrs["schema_version"] = np.int64(LATER)
        with pytest.raises(CalibrationError, match=f"version {LATER}, but what it holds is that of version {FIRST}"):
            read_calibration(path)
