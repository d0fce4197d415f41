"""Calibrations with a mended digest whose reading, or opening, would take far longer than their size explains."""

import json
import resource
from dataclasses import replace

import numpy as np
import pytest
from calibration_samples import sample_calibration
from pressed_sheets import issued_from_presses

from cbsr_qa.app.calibration.file import read_any
from cbsr_qa.calibration.file import hdf5
from cbsr_qa.calibration.file.content import Entry, content_digest, schema_version
from cbsr_qa.calibration.file.entries import encode
from cbsr_qa.calibration.file.hdf5 import read_in_child, stamp, write_calibration
from cbsr_qa.calibration.file.json import dataset, read_json_calibration
from cbsr_qa.calibration.runtime.calibration import Calibration
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.system.untrusted import CONTAINED

#: Processor time that is granted, with what starting a child takes [s].
_GRANTED_S = 10.0
_CORNERS = 120_000


def _circle(count, radius=50.0):
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return np.column_stack([np.cos(angle), np.sin(angle)]) * radius


def _repeated(entries, group, count):
    """Repeat the first row of each list in a group."""
    for path in [path for path in entries if path.startswith(group)]:
        value = entries[path].value
        longer = (value[0],) * count if isinstance(value, tuple) else np.repeat(value[:1], count, axis=0)
        entries[path] = Entry(entries[path].units, longer)


def _outline(entries):
    entries["sensor_type/outline/corners"] = Entry("mm", _circle(_CORNERS))
    entries["sensor_type/outline/corner_radius"] = Entry("mm", np.asarray(0.0))


def _rounded(entries):
    entries["sensor_type/outline/corners"] = Entry("mm", _circle(1001))
    entries["sensor_type/outline/corner_radius"] = Entry("mm", np.asarray(0.1))


def _head(entries):
    entries["indenter/outline"] = Entry("mm", _circle(_CORNERS, 5.0))


def _electrodes(entries):
    for name in ("electrodes/count", "pattern/electrode_count"):
        entries[f"sensor_type/{name}"] = Entry("1", np.asarray(10**9))


def _pairs(entries):
    entries["sensor_type/pattern/drive"] = Entry("index", np.tile([[0, 1]], (100_000, 1)))


def _readings(entries):
    entries["reference/voltages"] = Entry("V", np.ones((600, 600)))


def _used(entries):
    entries["reconstruction/used"] = Entry("flag", np.ones((300, 300), dtype=np.bool_))


def _relaxations(entries):
    for path in [path for path in entries if path.startswith("relaxation/conductance/")]:
        del entries[path]
    _repeated(entries, "relaxation/stress/", 15_000)
    entries["relaxation/stress/number"] = Entry("index", np.arange(15_000))


def _signals(entries):
    lists = {path: entry for path, entry in entries.items() if path.startswith("relaxation/stress/")}
    for number in range(30):
        entries.update({path.replace("stress", f"s{number}"): entry for path, entry in lists.items()})


def _places(entries):
    _repeated(entries, "baseline_conductance/", 20_001)


def _texts(entries):
    for path in ("assumed", "validity/reduced", "identity/simulated"):
        entries[path] = Entry("text", ("x",) * 34_000)


def _lattice(entries):
    for name in ("columns", "rows"):
        entries[f"force/lattice/{name}"] = Entry("1", np.asarray(1200))
    node = np.full((1200, 1200), -1)
    node.ravel()[:52] = np.arange(52)
    entries["force/node"] = Entry("index", node)


def _presses(entries):
    entries["place/process/features"] = Entry("1", np.zeros((4001, 2), dtype=np.float32))


def _forged(path, calibration, change):
    entries = dict(encode(calibration))
    change(entries)
    digest = content_digest(entries)
    if path.suffix == ".json":
        document = {"format": "cbsr-qa calibration", "schema_version": schema_version(entries), "digest": digest}
        path.write_text(json.dumps({**document, "datasets": {name: dataset(one) for name, one in entries.items()}}))
    else:
        path.write_bytes(hdf5._write_file(entries, digest))


@pytest.mark.parametrize("suffix", ["h5", "json"])
@pytest.mark.parametrize(
    ("change", "why"),
    [
        (_outline, "sensor_type/outline/corners: 120000 is too many; a calibration has at most 1000"),
        (_rounded, "sensor_type/outline/corners: 1001 is too many"),
        (_head, "indenter/outline: 120000 is too many; a calibration has at most 1000"),
        (_electrodes, "sensor_type/electrodes/count: 1000000000 is too many; a calibration has at most 256"),
        (_pairs, "sensor_type/pattern/drive: 100000 is too many"),
        (_readings, "reference/voltages: 360000 is too many; a calibration has at most 262144"),
        (_used, "reconstruction/used, readings: 90000 is too many; a calibration has at most 65536"),
        (_signals, "relaxation, signals: 32 is too many; a calibration has at most 20"),
        (_places, "baseline_conductance/location: 20001 is too many"),
        (_lattice, "force/node: 1440000 is too many"),
        (_presses, "place/process/features: 4001 is too many; a calibration has at most 4000"),
    ],
)
def test_what_would_take_time_that_grows_faster_than_the_file_is_counted_before(tmp_path, suffix, change, why):
    path = tmp_path / f"c.{suffix}"
    _forged(path, sample_calibration(), change)
    begun_s = _of_children()
    with pytest.raises(CalibrationError, match=why):
        read_any(path)
    assert _of_children() - begun_s < _GRANTED_S


def test_texts_are_counted_over_all_datasets(tmp_path):
    _forged(tmp_path / "c.h5", sample_calibration(), _texts)
    with pytest.raises(CalibrationError, match="more than 100000 texts up to"):
        read_any(tmp_path / "c.h5")


@pytest.mark.rest
def test_a_long_run_of_loads_is_read_and_opened(tmp_path):
    """Fifteen thousand relaxations: two hundred times a run's."""
    _forged(tmp_path / "c.h5", sample_calibration(), _relaxations)
    assert len(Calibration(read_any(tmp_path / "c.h5")).issued.relaxations) == 15_000


def test_presses_that_would_not_be_read_are_not_issued():
    issued = issued_from_presses()
    with pytest.raises(CalibrationError, match="readings/pairs: 70000 is too many; a calibration has at most 65536"):
        stamp(replace(issued, pairs=np.zeros((70_000, 4), dtype=np.int64)))


@pytest.mark.rest
@pytest.mark.skipif(not CONTAINED, reason="there are no reading children on this platform")
def test_a_calibration_gets_less_than_ten_seconds_whatever_is_slow_about_it(tmp_path):
    path = tmp_path / "c.h5"
    write_calibration(path, sample_calibration())
    with path.open("ab") as file:
        file.write(bytes(1_900_000))
    begun_s = _of_children()
    with pytest.raises(CalibrationError, match=r"took more than 8 s of processor time|took more than 5\d s"):
        read_in_child(path, _loop)
    assert _of_children() - begun_s < _GRANTED_S


def _of_children():
    """Processor time that children have taken [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _loop():
    while True:
        pass


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda text: text.replace('{"format"', '{"format": "x", "format"', 1), "the key 'format' appears twice"),
        (lambda text: text.replace('"units"', '"units": "N", "units"', 1), "the key 'units' appears twice"),
        (lambda text: text.replace('"datasets": {', '"datasets": {"assumed": {}, ', 1), "the key 'assumed' appears"),
        (lambda text: text[:-1] + ', "more": ' + "[" * 100_000, "nested more than 64 deep"),
        (lambda text: text[:-1] + f', "more": [{"[" * 70}{"]" * 70}]}}', "nested more than 64 deep"),
        (lambda text: text[:-1] + ', "more": 1e400}', "the number 1e400 is too large"),
        (lambda text: text[:-1] + f', "more": {"9" * 100_000}}}', "the number 9{60} is too large"),
        (lambda text: text[:-1] + ', "more": NaN}', "NaN is not a number in JSON"),
        (lambda text: text[:-1] + "".join(f', "k{n}": 1' for n in range(10**5)) + "}", "no calibration has the key"),
    ],
)
def test_json_that_two_programs_could_read_differently_is_refused(tmp_path, change, why):
    path = tmp_path / "c.json"
    _forged(path, sample_calibration(), lambda entries: None)
    assert read_json_calibration(path).sensor.serial
    path.write_text(change(path.read_text()))
    with pytest.raises(CalibrationError, match=rf"calibration .*c\.json: .*{why}"):
        read_any(path)
