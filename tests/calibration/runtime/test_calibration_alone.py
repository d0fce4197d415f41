"""A calibration away from the station: little to import, and a formula that anybody can follow."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bare_environments import run_beside
from calibration_samples import INDENTER, LOAD_CELL, sample_calibration
from force_calibration import NOISE_V, force_calibration, frames

from cbsr_qa.calibration.file.entries import encode
from cbsr_qa.calibration.file.firmware import firmware_document, measure_loss, thin_model
from cbsr_qa.calibration.file.hdf5 import write_calibration
from cbsr_qa.calibration.force.inverse import Flag
from cbsr_qa.calibration.force.template_matching import TemplateFilter
from cbsr_qa.calibration.force.templates import template_bank
from cbsr_qa.calibration.runtime.calibration import Calibration
from cbsr_qa.domain.errors import CalibrationError, NumericsError
from cbsr_qa.domain.kept import as_filed
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.domain.results.calibration import BatchUse
from cbsr_qa.domain.sensor.sensor_type import Parameter
from cbsr_qa.eit.estimate.readings import load_model, merge_reciprocal

_DOCS = Path(__file__).parents[3] / "docs"
_PAGE = (_DOCS / "reference" / "calibration-file.md").read_text()
_PLACES = np.array([(0.0, 0.0), (5.0, 7.0), (-20.3, 10.1), (25.0, -12.4), (-3.3, -31.0), (17.0, 30.5)])
_FORCES = np.array([1.2, 2.0, 3.0, 4.5, 5.4, 0.9])


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("issued") / "sensor.h5"
    write_calibration(path, force_calibration())
    return path


@pytest.fixture(scope="module")
def calibration(file):
    return Calibration.load(file)


# --- imports -------------------------------------------------------------------------------------------------

_ALONE = """
import sys
import numpy as np
from cbsr_qa.calibration import Calibration, ForceStream, load_calibration
forces = Calibration.load(sys.argv[1]).force(np.load(sys.argv[2]))
assert np.array_equal(load_calibration(sys.argv[1]).estimate(np.load(sys.argv[2])).force.values, forces.force_N)
loads = [ForceStream(Calibration.load(sys.argv[1])).update(0.0, frame) for frame in np.load(sys.argv[2])]
np.save(sys.argv[3], np.column_stack([forces.force_N, forces.stderr_N]))
"""


@pytest.mark.rest
def test_frames_become_the_same_force_with_numpy_scipy_and_h5py_alone(file, calibration, tmp_path):
    seen = frames(_PLACES, _FORCES)
    np.save(tmp_path / "frames.npy", seen)
    done = run_beside(("numpy", "scipy", "h5py"), _ALONE, file, tmp_path / "frames.npy", tmp_path / "out.npy")
    assert done.returncode == 0, done.stderr
    here = calibration.force(seen)
    np.testing.assert_allclose(np.load(tmp_path / "out.npy"), np.column_stack([here.force_N, here.stderr_N]))


# --- the formula of the page ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def printed(file):
    """The function the page prints, for a file of that name in the current folder."""
    code, _ = re.findall(r"```python\n(.*?)```", _PAGE, re.S)
    assert set(re.findall(r"^import (\w+)", code, re.M)) == {"h5py", "numpy"}
    assert "cbsr_qa" not in code
    namespace = {}
    exec(code.replace('"sensor.h5"', repr(str(file))), namespace)
    return namespace["force"]


def test_force_and_standard_error_follow_from_the_file_as_the_page_says(printed, calibration):
    seen = frames(_PLACES, _FORCES)
    ours = calibration.force(seen, place_mm=_PLACES)
    theirs = np.array([printed(frame, x, y) for frame, (x, y) in zip(seen, _PLACES, strict=True)])
    np.testing.assert_allclose(theirs[:, 0], ours.force_N, rtol=1e-6)
    np.testing.assert_allclose(theirs[:, 1], ours.stderr_N, rtol=2e-6)
    assert np.all(np.abs(ours.force_N - _FORCES) < 4 * ours.stderr_N)


def test_the_place_is_where_the_page_says(printed, calibration):
    """No place of a fine grid explains a frame better than the one that was found."""
    seen = frames([(12.3, -8.7)], [3.0])
    found = calibration.force(seen)
    rows, _ = calibration.rows(seen)
    step = np.linspace(-1.0, 1.0, 41)
    around = found.place_mm[0] + np.stack(np.meshgrid(step, step), axis=-1).reshape(-1, 2)
    matches = TemplateFilter(calibration.model).match_at(np.repeat(rows, len(around), axis=0), around)
    best = around[np.argmax(matches.gain)]
    assert np.hypot(*(best - found.place_mm[0])) < 0.1  # the interpolated score is not quite the score in between
    assert np.sqrt(matches.gain.max()) == pytest.approx(found.detectability[0], rel=1e-3)


def test_every_dataset_is_on_the_page_with_its_unit_and_kind_and_no_other():
    rows = re.findall(r"^\| `([^`]+)`( \(where it applies\))? \| ([^|]+) \| ([^|]+) \|", _PAGE, re.M)
    said = {path: (units.strip(), kind.strip()) for path, optional, units, kind in rows if not optional}
    found = {}
    stated = replace(LOAD_CELL, drift_a_year=0.1, resolution=0.01, range_low=0.5, range_high=20.0)
    sample = replace(
        sample_calibration(), standards=(stated, INDENTER), response_per_C=Parameter(0.01, None, "paper")
    )
    sample = replace(sample, force=replace(sample.force, batch=BatchUse("d" * 64, True, 0.4, 0.3)))
    filed = replace(sample, reconstruction=as_filed(sample.reconstruction))
    for path, entry in encode(filed).items():
        name = re.sub(r"^force/(un)?loading/", "force/<direction>/", path)
        name = re.sub(r"^relaxation/\w+/", "relaxation/<signal>/", name)
        kind = "text" if isinstance(entry.value, (str, tuple)) else entry.value.dtype.str[1:].replace("b1", "u1")
        units = "trace" if name.startswith("relaxation/") and said[name][0] == "trace" else entry.units
        found[name] = (units, kind)
    assert said == found


# --- frames that are not what they should be -----------------------------------------------------------------


_FRAME = frames(_PLACES[:1], _FORCES[:1])
_NO_NUMBERS = (lambda f: f * (1 + 1j), lambda f: f.astype(str), lambda f: f.astype(object))


@pytest.mark.parametrize(
    ("seen", "options", "error", "said"),
    [
        *(
            (np.zeros(shape), {}, CalibrationError, r"frames of shape .* are not of sensor S-1")
            for shape in ((8, 8), (2, 16, 15), (256,), (1, 1, 16, 16))
        ),
        *((cast(_FRAME), {}, NumericsError, "frames are of type") for cast in _NO_NUMBERS),
        *((_FRAME, {"place_mm": cast(_PLACES[0])}, NumericsError, "places are of type") for cast in _NO_NUMBERS),
        (_FRAME, {"place_mm": (1.0, 2.0, 3.0)}, CalibrationError, "places of shape"),
        *(
            (_FRAME, {"current_A": current}, CalibrationError, "is not a positive number")
            for current in (0.0, np.nan, np.inf, -1.0, "1 mA", 1e-3j)
        ),
    ],
)
def test_what_is_no_frame_place_or_current_is_refused(calibration, seen, options, error, said):
    with pytest.raises(error, match=said):
        calibration.force(seen, **options)


def test_what_cannot_be_a_frame_of_this_sensor_is_flagged_and_gives_no_number(calibration):
    good = frames([(5.0, 7.0)], [2.0])[0]
    broken, other = good.copy(), good[::-1, ::-1] * 1.7
    broken[: len(broken) // 2 + 2] = np.nan  # more than half of them
    loads = calibration.force(np.array([good, broken, other]))
    assert loads.flags[0] == 0
    assert loads.flags[1] == Flag.UNREADABLE
    assert loads.flags[2] == Flag.OTHER_SENSOR
    assert np.isnan(loads.force_N[1:]).all()
    assert np.isnan(loads.stderr_N[1:]).all()
    unused = good.copy()
    unused[0, 0] = np.nan  # of a driven electrode: it is not used
    np.testing.assert_allclose(calibration.force(unused).force_N, loads.force_N[:1], rtol=1e-12)


def test_a_masked_reading_is_missing_and_not_laid_bare(calibration):
    pressed = frames(np.repeat(_PLACES[:1], 2, axis=0), np.full(2, 3.0))
    mask = np.zeros(pressed.shape, dtype=bool)
    mask[1][tuple(np.argwhere(calibration.issued.reconstruction.problem.used)[0])] = True
    found = calibration.force(np.ma.masked_array(pressed, mask))
    assert found.flags.tolist() == [0, Flag.MISSING]
    assert found.force_N == pytest.approx(np.full(2, 3.0), abs=0.3)
    assert found.force_N[1] != found.force_N[0]


def test_a_frame_that_cannot_be_used_has_no_place_found(calibration):
    found = calibration.force(np.full((1, 16, 16), np.nan))
    assert np.isnan([*found.place_mm[0], found.place_stderr_mm[0]]).all()
    given = calibration.force(np.full((1, 16, 16), np.nan), place_mm=(1.0, 2.0))
    assert given.place_mm.tolist() == [[1.0, 2.0]]


def test_templates_of_a_few_heads_are_kept_and_not_of_every_one(calibration):
    pressed = frames(_PLACES[:1], _FORCES[:1])
    before = calibration.force(pressed).force_N
    for tenth in range(100, 130):
        calibration.force(pressed, indenter=Indenter(tenth / 10))
    assert len(calibration._filters) <= 8
    assert calibration.force(pressed).force_N == before


def test_a_place_where_no_head_can_be_is_outside_and_gives_no_number(calibration):
    good = frames([(5.0, 7.0)], [2.0])
    for place in ((46.0, 10.0), (400.0, 0.0), (0.0, -49.9)):
        load = calibration.force(good, place_mm=place)
        assert load.flags.tolist() == [Flag.OUTSIDE]
        assert np.isnan(load.force_N).all()


@pytest.mark.parametrize("size", [0.0, 1e-300, 1e-12, 1e-3, 0.1, 1.0, 1e3, 1e150, 1e300])
def test_noise_of_any_size_is_flagged_wherever_it_gives_no_number(calibration, size):
    noise = size * np.random.default_rng(1).standard_normal((50, 16, 16))
    for place in (None, (3.0, 4.0), (46.0, 0.0)):
        load = calibration.force(calibration.issued.reference + noise, place_mm=place)
        missing = ~np.isfinite(load.force_N) | ~np.isfinite(load.stderr_N) | ~np.isfinite(load.place_stderr_mm)
        assert (load.flags[missing] != 0).all()


def test_a_model_in_which_nothing_can_be_searched_is_refused(calibration):
    model = calibration.issued.force
    corner = np.zeros_like(model.fits)
    corner[0] = True
    with pytest.raises(CalibrationError, match="no place on the lattice that a head could be searched from"):
        Calibration(replace(calibration.issued, force=replace(model, fits=corner)))


def test_a_calibration_without_a_model_says_why_it_gives_no_force(file):
    issued = force_calibration()
    with pytest.raises(CalibrationError, match="0193-c of sensor S-1 holds no force model: too few loads"):
        Calibration(replace(issued, force=None, no_force="too few loads"))


def test_rounding_of_a_file_changes_no_force_by_more_than_a_two_thousandth(calibration):
    """Against the model whose templates are prepared again in double precision."""
    issued = calibration.issued
    kind, used = issued.sensor_type, issued.reconstruction.problem.used
    readings = merge_reciprocal(kind.pattern, used, np.full(used.shape, (NOISE_V / 7.24) ** 2))
    bank = template_bank(load_model(kind), readings, Indenter(13.0))
    double = replace(
        issued.force,
        templates=bank.templates,
        log_size=bank.log_size,
        size_slope=bank.size_slope,
        log_size_gradient=bank.slopes[:, :2],
        turning=bank.slopes[:, 2:],
    )
    assert np.abs(double.templates - issued.force.templates).max() > 1e-10
    seen = frames(_PLACES, _FORCES)
    for place in (None, _PLACES):
        here = calibration.force(seen, place_mm=place)
        there = Calibration(replace(issued, force=double)).force(seen, place_mm=place)
        np.testing.assert_allclose(here.force_N, there.force_N, rtol=5e-4)
        np.testing.assert_allclose(here.stderr_N, there.stderr_N, rtol=5e-4)


# --- firmware ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def firmware():
    return json.loads(json.dumps(firmware_document(force_calibration()), allow_nan=False))


def test_the_reader_that_the_page_prints_gives_the_same_forces_but_for_the_loss_that_is_stated(
    firmware, calibration, tmp_path
):
    _, code = re.findall(r"```python\n(.*?)```", _PAGE, re.S)
    assert set(re.findall(r"^import (\w+)", code, re.M)) == {"json", "math"}
    (tmp_path / "firmware.json").write_text(json.dumps(firmware))
    namespace = {}
    exec(code.replace('"firmware.json"', repr(str(tmp_path / "firmware.json"))), namespace)
    worst = firmware["loss"]["relative_force_error_worst"]
    assert firmware["loss"]["places_lost"] == 0
    assert 0 < worst <= 0.02
    for noise, rtol, share in ((0.0, 1.5 * worst, 0.0), (NOISE_V, worst, 0.1)):
        seen = frames(_PLACES, _FORCES, noise)
        ours = calibration.force(seen, place_mm=_PLACES)
        of_each = zip(seen, _PLACES, strict=True)
        theirs = [namespace["force"](frame.ravel().tolist(), x, y) for frame, (x, y) in of_each]
        # Of noise, a coarser template takes another share: a fraction of its own error.
        np.testing.assert_allclose(theirs, ours.force_N, rtol=rtol, atol=share * ours.stderr_N.max())
    assert namespace["force"](seen[0].ravel().tolist(), 60.0, 0.0) is None
    assert namespace["force"](seen[0].ravel().tolist(), 49.9, 0.0) is None


def test_the_firmware_file_is_small_and_says_what_it_is_of(firmware):
    assert len(json.dumps(firmware, separators=(",", ":"))) < 1e6
    assert firmware["digest"] == force_calibration().digest
    assert firmware["flags"]["UNREADABLE"] == Flag.UNREADABLE
    page, _, anchor = firmware["formula"].partition("#")
    assert (_DOCS.parent / page).exists()
    headings = re.findall(r"^## (.+)$", _PAGE, re.M)
    assert anchor in {re.sub(r"[^a-z0-9 -]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_a_finer_lattice_loses_less_and_the_same_lattice_only_its_bits():
    issued = force_calibration()
    losses = [measure_loss(issued, thin_model(issued.force, stride)) for stride in (4, 2, 1)]
    rms = [loss.relative_force_error_rms for loss in losses]
    assert rms[0] > 4 * rms[1] > 4 * rms[2]
    assert losses[2].relative_force_error_worst < 1e-3
    assert losses[2].places_lost == 0


def test_what_firmware_cannot_be_made_of_is_refused():
    issued = force_calibration()
    with pytest.raises(CalibrationError, match="holds no force model: too few"):
        firmware_document(replace(issued, force=None, no_force="too few"))
    with pytest.raises(CalibrationError, match="a stride of 40 leaves no lattice; 1 to 20 are allowed"):
        firmware_document(issued, stride=40)
    mixed = replace(issued.force, merging=issued.force.merging + 1e-3)
    with pytest.raises(CalibrationError, match="a reading to several rows"):
        firmware_document(replace(issued, force=mixed))
