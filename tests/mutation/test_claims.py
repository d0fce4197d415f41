"""Files that claim what they do not hold: links, data elsewhere, and sizes that no memory has."""

import json
import os
import struct
import zlib

import h5py
import numpy as np
import pytest
import scipy.io
from calibration_samples import edited, plain_digest, sample_calibration
from test_recording_file import sample

from cbsr_qa.analysis import recording_files
from cbsr_qa.analysis.recording.reading import read_recording_file
from cbsr_qa.analysis.recording_files import write_recording
from cbsr_qa.app.analyse import analyse
from cbsr_qa.app.analyse.request import AnalyseRequest
from cbsr_qa.app.calibration.file import read_any
from cbsr_qa.app.calibration.page import show_calibration
from cbsr_qa.app.calibration.signing import verify_file
from cbsr_qa.calibration.file.hdf5 import read_calibration, write_calibration
from cbsr_qa.domain.errors import CalibrationError, RecordingError
from cbsr_qa.plugin.discovery import discover


def _read(path):
    return read_recording_file(path, discover(), format_=None, dataset=None)


@pytest.fixture
def secret(tmp_path):
    path = tmp_path / "passwd"
    path.write_bytes(b"root:x:0:0" * 200)
    return path


@pytest.fixture
def recording(tmp_path):
    path = tmp_path / "r.h5"
    write_recording(path, sample())
    return path


@pytest.fixture
def issued(tmp_path):
    path = tmp_path / "c.h5"
    write_calibration(path, sample_calibration())
    return path


def _linked(file, secret):
    file["samples/00/values"] = h5py.ExternalLink(str(secret), "/x")


def _soft(file, secret):
    file["samples/00/values"] = h5py.SoftLink("/samples/00/time_s")


def _outside(file, secret):
    file.create_dataset("samples/00/values", (6,), "f8", external=[(str(secret), 0, 48)]).attrs["unit"] = "N"


def _pipe(file, secret):
    secret.unlink()
    os.mkfifo(secret)
    _outside(file, secret)


def _filled(file, secret):
    file.create_dataset("samples/00/values", (10 * 2**27,), "f8", fillvalue=1.0, chunks=(1000,))


def _bytes(file, secret):
    file.create_dataset("samples/00/values", (2**22,), "i1", fillvalue=1, chunks=(1000,))


def _chunk(file, secret):
    file.create_dataset("samples/00/values", (6,), "f8", chunks=(2**28,), maxshape=(None,))


def _virtual(file, secret):
    layout = h5py.VirtualLayout((6,), "f8")
    layout[:] = h5py.VirtualSource(str(secret), "x", (6,))
    file.create_virtual_dataset("samples/00/values", layout)


def _compound(file, secret):
    file.create_dataset("samples/00/values", (6,), np.dtype([("a", "f8"), ("b", "i4")]))


def _packed(file, secret):
    file.create_dataset("samples/00/values", data=np.zeros(6), compression="lzf")


_CLAIMS = [
    (_linked, "samples/00/values is a link, not content"),
    (_soft, "samples/00/values is a link, not content"),
    (_outside, "samples/00/values does not hold its own data"),
    (_pipe, "samples/00/values does not hold its own data"),
    (_virtual, "samples/00/values does not hold its own data"),
    (_filled, "samples/00/values of the shape .* too large: all datasets of a file of this size may hold 16 MiB"),
    (_bytes, "samples/00/values of the shape .* too large"),
    (_chunk, "samples/00/values of the shape .* too large"),
    (_compound, "which is neither number nor text"),
    (_packed, "packed otherwise than with gzip"),
]


@pytest.mark.parametrize(("change", "said"), _CLAIMS)
def test_a_recording_holds_its_own_data_and_no_more_than_it_can(recording, secret, change, said):
    with h5py.File(recording, "r+") as file:
        del file["samples/00/values"]
        change(file, secret)
    with pytest.raises(RecordingError, match=rf"r\.h5.*{said}"):
        _read(recording)


def test_a_digest_that_fits_a_recording_forged_by_hand_opens_it(recording):
    """What the tests above change is what they are refused for, not the digest."""
    with h5py.File(recording, "r+") as file:
        file["samples/00/values"][0] = 7.0
        file.attrs["sha256"] = recording_files._digest(file)
    assert _read(recording).samples[0].values[0] == 7.0


def _described(**values):
    def change(file):
        said = json.loads(file.attrs["description"])
        file.attrs["description"] = json.dumps({**said, **values})

    return change


def _attribute(item, name, value):
    return lambda file: file[item].attrs.__setitem__(name, value)


def _replaced(name, value):
    def change(file):
        unit = file[name].attrs["unit"]
        del file[name]
        if value is None:
            file.create_group(name)
        else:
            file.create_dataset(name, data=value).attrs["unit"] = unit

    return change


_LAYOUT = {
    "count": 16,
    "kind": "pin",
    "ring_radius_mm": 40.0,
    "width_mm": 1.0,
    "first_angle_deg": 0.0,
    "counterclockwise": True,
}
_STRANGE = [
    (_described(sensor_type=5), "description.sensor_type is 5"),
    (_described(sensor_type=["a"]), r"description.sensor_type is \['a'\]"),
    (_described(sensor_type={"a": 1}), "description.sensor_type is a table"),
    (_described(dataset="x" * 60_000), r"description.dataset is 'x+'.* \(60000 characters\)"),
    (_described(notes=5), "description.notes is 5"),
    (_described(notes=[["a"]]), r"description.notes\[1\] is \['a'\]"),
    (_described(simulated="abc"), "description.simulated is 'abc'"),
    (_described(simulated=[{"a": 1}]), r"description.simulated\[1\] is a table"),
    (_described(scan="x"), "description.scan is 'x'"),
    (_described(still="no"), "description.still is 'no'"),
    (_described(frames_dropped=-5), "description.frames_dropped is -5"),
    (_described(frames_dropped=1e308), "description.frames_dropped is 1e.308"),
    (_described(frames_dropped=float("nan")), "attribute description of / is not JSON"),
    (_described(layout=[]), r"description.layout is \[\]"),
    (_described(layout={}), "description.layout.count is missing"),
    (_described(layout={**_LAYOUT, "count": 15.5}), "description.layout.count is 15.5"),
    (_described(layout={**_LAYOUT, "width_mm": None}), "description.layout.width_mm is None"),
    (_described(layout={**_LAYOUT, "kind": "x"}), "description.layout.kind is 'x'"),
    (_described(layout={**_LAYOUT, "more": 1}), "description.layout.more is not a known key"),
    (
        _described(layout={"kind": "pin", "places_mm": [[1]], "width_mm": 1}),
        r"description.layout.places_mm\[1\] is \[1\]",
    ),
    (_attribute("/", "description", "[" * 60_000), "attribute description of / is not JSON"),
    (_attribute("/", "description", '{"scan": "full", "scan": "full"}'), "not JSON: the key 'scan' appears twice"),
    (_attribute("/", "description", "7"), "description is 7; an object is expected"),
    (_attribute("/", "schema_version", 1e308), "has no schema version, or not a whole"),
    (_attribute("/", "schema_version", "9" * 6000), "has no schema version, or not a whole"),
    (_attribute("frames", "current_A", 1 + 2j), r"the drive current .* is complex128; one finite real number"),
    (_attribute("frames", "current_A", True), r"the drive current .* is True; one finite real number"),
    (_attribute("frames", "current_A", "x"), r"the drive current .* is x; one finite real number"),
    (_attribute("frames", "current_A", np.ones(2)), r"the drive current .*; one finite real number"),
    (_attribute("frames/voltages", "unit", "V" * 60_000), "attribute unit of /frames/voltages has 60000"),
    (_attribute("frames/voltages", "unit", "mV"), "/frames/voltages has unit 'mV'; allowed: V, count"),
    (_attribute("frames/voltages", "unit", 3.0), "attribute unit of /frames/voltages is missing or is not a single"),
    (
        _attribute("frames/voltages", "unit", b"\xff"),
        "attribute unit of /frames/voltages is missing or is not a single",
    ),
    (_replaced("frames/flags", None), "/frames/flags is a group; a dataset is expected"),
    (_replaced("frames/flags", 0.5), "/frames/flags holds values of type float64, not whole numbers"),
    (_replaced("samples/00/values", np.ones(3)), r"/samples/00/values has shape \(3,\)"),
    (_replaced("loads/trial", np.ones(9, int)), r"/loads/trial has shape \(9,\)"),
    (lambda file: file.create_group("samples/zz"), "time_s is missing in /samples/zz"),
    (lambda file: file.__delitem__("frames/flags"), "flags is missing in /frames"),
]


@pytest.mark.parametrize(("change", "said"), _STRANGE)
def test_what_a_recording_holds_in_place_of_something_else_is_refused_by_name(recording, change, said):
    with h5py.File(recording, "r+") as file:
        change(file)
        file.attrs["sha256"] = recording_files._digest(file)
    with pytest.raises(RecordingError, match=rf"r\.h5.*{said}") as refused:
        _read(recording)
    assert len(refused.value.reason) < 400


@pytest.mark.parametrize("named", ["/etc/passwd", "x.toml", "../disc-100mm", "a/\0", "no-such", "/" + "a" * 900])
def test_a_recording_names_a_shipped_sensor_type_or_none_and_no_file(recording, monkeypatch, named):
    opened = []
    monkeypatch.setattr("cbsr_qa.app.analyse.analyse.load_sensor_type", opened.append)
    with h5py.File(recording, "r+") as file:
        _described(sensor_type=named)(file)
        file.attrs["sha256"] = recording_files._digest(file)
    found, remarks = analyse._sensor_type(_read(recording), AnalyseRequest())
    assert (found, opened) == (None, [])
    assert len(remarks[0]) < 300
    assert "is not a shipped one" in remarks[0]


def test_texts_that_are_all_the_same_megabyte_are_refused(issued):
    big, count = "x" * 2**20, 5000
    with edited(issued) as file:
        del file["assumed"]
        texts = file.create_dataset("assumed", data=[big, *["y"] * (count - 1)], dtype=h5py.string_dtype())
        texts.attrs["units"] = "text"
    with h5py.File(issued) as file:
        at = file["assumed"].id.get_offset()
    data = bytearray(issued.read_bytes())
    data[at : at + 16 * count] = data[at : at + 16] * count
    issued.write_bytes(data)
    with pytest.raises(CalibrationError, match="assumed holds more than 16777216 characters"):
        read_any(issued)


def test_of_a_changed_calibration_hdf5_sees_nothing(issued, monkeypatch):
    data = bytearray(issued.read_bytes())
    data[700] ^= 1
    issued.write_bytes(data)
    monkeypatch.setattr(h5py.h5f, "open_file_image", lambda image: pytest.fail("HDF5 was given the bytes"))
    with pytest.raises(CalibrationError, match="the SHA-256 of its bytes is not the one it states"):
        read_calibration(issued)


@pytest.mark.parametrize("at", [0, 30, 100, 300, 511])
def test_a_changed_byte_of_the_digest_is_refused_too(issued, at):
    data = bytearray(issued.read_bytes())
    data[at] ^= 1
    issued.write_bytes(data)
    with pytest.raises(CalibrationError, match="truncated, damaged"):
        read_calibration(issued)


def test_a_file_says_what_it_is_and_other_programs_open_it_as_before(issued, tmp_path):
    head = issued.read_bytes()[:512]
    assert head.startswith(b"cbsr-qa calibration file: HDF5 after these 512 bytes\nSHA-256 of what follows them: ")
    with h5py.File(issued) as file:
        assert (file.userblock_size, file["image/mask"].attrs["units"]) == (512, "1")
    again = tmp_path / "again.h5"
    write_calibration(again, sample_calibration())
    assert again.read_bytes() == issued.read_bytes()


def test_a_file_that_another_program_copied_is_read_and_verify_says_that_its_bytes_were_not_checked(issued):
    assert verify_file(issued).result.bytes_checked
    with edited(issued):
        pass
    assert plain_digest(issued) == show_calibration(issued).result.digest
    assert not verify_file(issued).result.bytes_checked


def test_json_of_millions_of_values_is_refused_before_it_is_parsed(tmp_path):
    path = tmp_path / "c.json"
    path.write_bytes(b"[" + b"[]," * 5_000_000 + b"0]")
    with pytest.raises(CalibrationError, match="JSON of more than 250000 values"):
        read_any(path)


@pytest.mark.parametrize("nested", [b"[" * 200_000, b'{"datasets":' * 200_000])
def test_json_nested_without_end_is_refused(tmp_path, nested):
    path = tmp_path / "c.json"
    path.write_bytes(nested)
    with pytest.raises(CalibrationError, match="not JSON"):
        read_any(path)


# --- MATLAB files --------------------------------------------------------------------------------------------


def _element(kind, data):
    return struct.pack("<II", kind, len(data)) + data + b"\0" * (-len(data) % 8)


def _variable(cls, shape, name, *parts, flags=0):
    head = _element(6, struct.pack("<II", cls | flags << 8, 0)) + _element(5, struct.pack(f"<{len(shape)}i", *shape))
    return _element(14, head + _element(1, name) + b"".join(parts))


def _mat(path, *elements):
    path.write_bytes(b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + b"".join(elements))
    return path


FRAMES = _variable(6, (256, 2), b"vv", _element(9, np.arange(512.0).tobytes()))


@pytest.mark.rest
def test_matrices_are_read_as_scipy_reads_them(tmp_path):
    rng = np.random.default_rng(5)
    kinds = ["f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8"]
    for kind in kinds:
        values = rng.integers(0, 100, (256, 3)).astype(kind)
        for packed in (False, True):
            path = tmp_path / "tank.mat"
            content = {"a": values, "c": values.astype(complex), "l": values > 3, "s": {"x": 1}}
            scipy.io.savemat(path, content, do_compression=packed)
            expected = scipy.io.loadmat(path)["a"].T.reshape(-1, 16, 16)
            seen = _read(path).frames
            used = seen.flags == 0
            np.testing.assert_array_equal(seen.voltages[used], expected[used])


def test_structures_nested_by_thousands_are_not_looked_into(tmp_path):
    nested = b""
    for _ in range(4_000):
        nested = _variable(1, (1, 1), b"", nested)
    assert len(_read(_mat(tmp_path / "n.mat", nested, FRAMES)).frames) == 2


def _zip(data):
    return struct.pack("<II", 15, len(data)) + data


def test_a_packed_matrix_is_unpacked_as_far_as_it_claims_and_may(tmp_path):
    zeros = bytes(2**23)
    shape, claimed = (256, 2**21), 2**32 - 8
    head = _element(6, struct.pack("<II", 6, 0)) + _element(5, struct.pack("<2i", *shape)) + _element(1, b"vv")
    large = struct.pack("<II", 14, claimed) + head + struct.pack("<II", 9, claimed) + zeros
    with pytest.raises(RecordingError, match=r"vv of \(256, 2097152\) is too large for a file of"):
        _read(_mat(tmp_path / "large.mat", _zip(zlib.compress(large))))
    many = _variable(6, (256, 2**14), b"vv", _element(2, bytes(256 * 2**14)))  # a byte each, but eight once read
    with pytest.raises(RecordingError, match=r"vv of \(256, 16384\) is too large for a file of"):
        _read(_mat(tmp_path / "many.mat", _zip(zlib.compress(many))))
    assert len(_read(_mat(tmp_path / "more.mat", _zip(zlib.compress(FRAMES + zeros)))).frames) == 2


@pytest.mark.parametrize(
    "damaged",
    [
        FRAMES[:-9],
        _variable(6, (256, 2), b"vv", _element(9, bytes(8))),
        _variable(6, (256, -2), b"vv", _element(9, bytes(8))),
        _variable(6, (256, 2), b"vv", _element(77, bytes(4096))),
        _variable(6, (256, 2), b"vv"),
        _zip(b"no stream"),
        b"\xff" * 64,
    ],
)
def test_damaged_matrices_are_refused(tmp_path, damaged):
    with pytest.raises(RecordingError, match=r"d\.mat cannot be read as a MATLAB file"):
        _read(_mat(tmp_path / "d.mat", damaged))
