"""The calibration file: refusal of everything unsound, and nothing half-written."""

import os
import subprocess
import sys
import textwrap

import h5py
import numpy as np
import pytest
from calibration_samples import edited, forged, sample_calibration

from cbsr_qa.calibration.file.content import FORMAT, latest_version
from cbsr_qa.calibration.file.hdf5 import read_calibration, verify_calibration_file, write_calibration
from cbsr_qa.domain.errors import CalibrationError

# --- what is refused ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 0.999])
def test_a_truncated_file_is_refused(issued, share):
    whole = issued.read_bytes()
    issued.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(CalibrationError, match=rf"{issued.name}.*(truncated|changed)"):
        read_calibration(issued)


def _set(path, value):
    return lambda file: file[path].__setitem__(..., value)


def _attribute(name, value):
    return lambda file: file.attrs.__setitem__(name, value)


def _added(path, units="1", **given):
    """A dataset, in place of the one that may be there."""

    def change(file):
        file.pop(path, None)
        file.create_dataset(path, **given).attrs["units"] = units

    return change


def _link_out_of_the_file(file):
    del file["image/mask"]
    file["image/mask"] = h5py.ExternalLink(file.filename.replace("S-001", "secret"), "/x")


def _many_names(file):
    inner = file.create_group("b0")
    for depth in range(1, 4):
        outer = file.create_group(f"b{depth}")
        for number in range(60):
            outer[f"x{number}"] = inner
        inner = outer


_CHANGED = "changed after it was issued"
_TEXTS = {"dtype": h5py.string_dtype(), "chunks": True}
_UNSOUND = {
    "value": (_set("baseline_conductance/value", [0.32, np.nan]), _CHANGED),
    "text": (_set("identity/serial", "S-002"), _CHANGED),
    "range": (_set("validity/force", [0.0, 99.0]), _CHANGED),
    "flag": (_set("sensor_type/electrodes/counterclockwise", True), _CHANGED),
    "count": (_set("settling/accepted", [9, 0]), _CHANGED),
    "units": (lambda file: file["validity/force"].attrs.__setitem__("units", "kN"), _CHANGED),
    "one more": (_added("extra", data=1.0), _CHANGED),
    "one less": (lambda file: file.__delitem__("image/mask"), _CHANGED),
    "no digest": (lambda file: file.attrs.__delitem__("digest"), "states no SHA-256"),
    "a digest to print": (_attribute("digest", "\x1b[31mred"), "states no SHA-256"),
    "later version": (_attribute("schema_version", np.int64(99)), f"version 99.*up to {latest_version(FORMAT)}"),
    "version 0": (_attribute("schema_version", np.int64(0)), "version"),
    "half a version": (_attribute("schema_version", np.float64(1.0)), "version"),
    "version in words": (_attribute("schema_version", "1"), "version"),
    "format of numbers": (_attribute("format", np.array([1, 2])), "not a calibration"),
    "two formats": (_attribute("format", np.array(["cbsr-qa calibration"] * 2, dtype=object)), "not a calibration"),
    "format of a number": (_attribute("format", 3.0), "not a calibration"),
    "names within names": (_many_names, "more than 2000 names"),
    "table of texts": (_added("assumed", "text", shape=(1, 2), **_TEXTS), "assumed holds texts of the shape"),
    "millions of texts": (
        _added("assumed", "text", shape=(2**26,), **_TEXTS),
        "more than 100000 texts up to assumed",
    ),
    "control characters": (_added("force/\x1b[2J", data=np.complex128(1)), "is not a name of such a file"),
    "circle": (lambda file: file.__setitem__("image/again", file["image"]), "is a link"),
    "link out of the file": (_link_out_of_the_file, "image/mask is a link"),
    "terabytes": (_added("huge", shape=(10**12,), dtype="f8", chunks=(1000,)), "too large"),
    "half precision": (_added("odd", data=np.zeros(2, dtype="f2")), "odd is of the type float16"),
}


@pytest.mark.parametrize("what", _UNSOUND)
def test_an_unsound_file_is_refused(issued, what):
    change, said = _UNSOUND[what]
    with h5py.File(issued.with_name("secret.h5"), "w") as file:
        file["x"] = 1.0
    with edited(issued) as file:
        change(file)
    for read in (read_calibration, verify_calibration_file):
        with pytest.raises(CalibrationError, match=said) as caught:
            read(issued)
        assert "\x1b" not in caught.value.reason


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("notes.txt", "no HDF5 at all", "not a whole HDF5 file"),
        (
            "x.json",
            '{"format": "cbsr-calibration"}',
            r"JSON, not HDF5.*\n.*calibration export X\.json --output X\.h5",
        ),
        ("absent.h5", None, "no such file"),
        ("", None, "it is a folder, not a file"),
        ("x" * 300, None, "cannot be read: File name too long"),
    ],
)
def test_what_is_no_hdf5_file_is_refused(tmp_path, name, content, said):
    if content:
        (tmp_path / name).write_text(content)
    with pytest.raises(CalibrationError, match=said):
        read_calibration(tmp_path / name)


def test_another_hdf5_file_is_refused(tmp_path):
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["x"] = 1.0
    with pytest.raises(CalibrationError, match="not a calibration"):
        read_calibration(tmp_path / "other.h5")


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        ("baseline_conductance/x", np.zeros(3), "contradicts itself"),
        ("image/mask", None, "image/mask is missing"),
        ("image/mask", "0.85", "image/mask does not hold float64 numbers"),
        ("identity/serial", 3.0, "identity/serial is not a text"),
        ("image/noise_floor", [1.0, 2.0], "shape"),
        ("image/response", "sideways", "sideways"),
        ("validity/force", [1.0, 2.0, 3.0], "instead of two"),
        ("mesh/electrode_edge_counts", [1, 1], "the counts say 2"),
        ("reconstruction/matrix_columns", [[1.0]], "does not fit"),
        ("relaxation/stress/number", [0], "not 0, 1, 2"),
        ("area_overlap/size_ratio", [1.0], "instead of two"),
    ],
)
def test_content_of_the_wrong_kind_is_named_even_with_a_fitting_digest(issued, path, value, said):
    with forged(issued) as file:
        del file[path]
        if value is not None:
            file.create_dataset(path, data=value).attrs["units"] = "1"
    with pytest.raises(CalibrationError, match=said):
        read_calibration(issued)


# --- nothing half-written ------------------------------------------------------------------------------------


def test_a_failed_write_leaves_the_old_file_and_nothing_else(issued, monkeypatch):
    before = issued.read_bytes()

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(CalibrationError, match="No space left on device"):
        write_calibration(issued, sample_calibration())
    assert issued.read_bytes() == before
    assert list(issued.parent.iterdir()) == [issued]


def test_a_folder_that_is_a_file_is_refused(tmp_path):
    (tmp_path / "calibrations").write_text("in the way")
    with pytest.raises(CalibrationError, match="cannot be written"):
        write_calibration(tmp_path / "calibrations" / "x.h5", sample_calibration())


def test_a_disk_without_room_for_it_is_said_and_leaves_nothing(tmp_path):
    """In a process of its own, whose files may not grow: HDF5 used to crash it where it could not close its file."""
    code = """
    import resource, sys
    from pathlib import Path
    from calibration_samples import sample_calibration
    from cbsr_qa.calibration.file.hdf5 import write_calibration
    from cbsr_qa.domain.errors import CalibrationError
    calibration = sample_calibration()
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
    try:
        write_calibration(Path(sys.argv[1]), calibration)
    except CalibrationError as error:
        sys.stdout.write(error.reason)
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code), str(tmp_path / "c.h5")],
        check=False,
        capture_output=True,
        text=True,
        timeout=120,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "c.h5 cannot be written: File too large" in done.stdout
    assert list(tmp_path.iterdir()) == []
