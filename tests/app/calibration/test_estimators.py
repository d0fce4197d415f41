"""Every calibration is applied through one Protocol: also one that apply, stream and notebooks have never seen."""

import json

import numpy as np
import pytest
from pressed_sheets import issued_from_presses
from streamed import write_sensor
from typer.testing import CliRunner

import cbsr_qa as qa
from cbsr_qa.calibration import loading
from cbsr_qa.calibration.file.hdf5 import write_calibration
from cbsr_qa.calibration.force.inverse import Flag
from cbsr_qa.calibration.runtime.estimator import (
    AS_CALIBRATED,
    Ability,
    CalibrationIdentity,
    Estimator,
    Regions,
    Touches,
    TouchValues,
    require_ability,
)
from cbsr_qa.cli.main import app
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.results.calibration import Calibration as IssuedByRun
from cbsr_qa.system.clock import VirtualClock

_FRAMES = 30
_NO_95 = "was learned from so few sensors that it states no 95 %"


class BatchEstimator:
    """A third way to calibrate, learned from other sensors of a batch: the sum of a frame's change is its force."""

    head = None
    force_error = "scatter only; load cell not stated"

    def __init__(self, issued, *, regions=False, force=True):
        self.issued = issued
        self.sensor_type, self.pattern = issued.sensor_type, issued.sensor_type.pattern
        self.regions = Regions(2.3, None) if regions else None
        self.lacks = {Ability.REGION_95: _NO_95, Ability.FORCE_95: _NO_95, Ability.SERIAL: "is of a batch"}
        if not regions:
            self.lacks[Ability.REGION] = "states standard errors"
        if not force:
            self.lacks[Ability.FORCE] = "was learned from sensors without load cells"
        self.identity = CalibrationIdentity("", "0193-b", "00", "batch", "disc-100mm", 16, "mm from the centre")

    def estimate(self, frames):
        """Touches of frames (n, drives, measures) [V]."""
        change = np.asarray(frames) - self.issued.reference
        force_N = 40 * np.abs(change).reshape(-1, self.issued.reference.size).sum(axis=1)
        count, touch = len(force_N), force_N > 2
        spread = np.tile(np.diag([4.0, 1.0]), (count, 1, 1))
        within = np.stack([force_N - 0.5, force_N + 0.5], axis=1)
        return Touches(
            touch=touch,
            flags=np.where(touch, 0, int(Flag.NOT_DETECTED)),
            place_mm=np.column_stack([force_N, -force_N]),
            place_stderr_mm=np.full(count, 1.5),
            radius_68_mm=np.full(count, 3.0),
            radius_95_mm=None,
            covariance_mm2=spread if self.regions else None,
            force=None if Ability.FORCE in self.lacks else TouchValues(force_N, within, None),
        )

    def prepare(self):
        """Nothing is worked out."""

    def check_recording(self, recording):
        """Any recording will do."""

    def follow(self, name, first, unloaded=AS_CALIBRATED, *, timed=True, place_mm=None):
        """Frames by themselves."""
        return _Sequence(self, unloaded)

    def estimate_readings(self, pairs, readings, *, relative=False, differences=False):
        """No named pairs."""
        require_ability(self, Ability.READINGS)


class _Sequence:
    def __init__(self, estimator, unloaded):
        self._estimator = estimator
        self.remarks = ("learned from a batch", *(("differences",) if unloaded.differences else ()))
        if unloaded.rest is not None:
            self.remarks += (f"{len(unloaded.rest)} frames at rest",)

    def estimate(self, frames):
        return self._estimator.estimate(frames.voltages)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("estimators")
    write_sensor(folder, _FRAMES)
    return folder


@pytest.fixture(autouse=True)
def _in_the_folder(folder, monkeypatch):
    monkeypatch.chdir(folder)
    monkeypatch.setattr("cbsr_qa.app.stream.source.RealClock", VirtualClock)


def _use(monkeypatch, **options):
    """Let files of runs be applied by the third way."""
    monkeypatch.setitem(loading.ESTIMATORS, IssuedByRun, lambda issued: BatchEstimator(issued, **options))


def _apply(*options):
    done = CliRunner().invoke(app, ["calibration", "apply", "sensor.h5", "press.h5", "--json", *options])
    assert not done.exception, done.exception
    return json.loads(done.stdout)


def _stream():
    return list(qa.stream("sensor.h5", driver="replayed-recording", options={"file": "press.h5"}))


def test_both_kinds_of_file_are_estimators(folder):
    estimator: Estimator = qa.load_calibration("sensor.h5")
    assert isinstance(estimator, qa.Calibration)
    assert estimator.identity.kind == "run"
    write_calibration(folder / "skin.h5", issued_from_presses())
    assert isinstance(qa.load_calibration("skin.h5"), qa.PressCalibration)
    with pytest.raises(CalibrationError, match="learned from labelled presses"):
        qa.Calibration.load("skin.h5")
    assert estimator.lacks[Ability.READINGS] == "was issued by a run"
    with pytest.raises(CalibrationError, match="the calibration was issued by a run"):
        estimator.estimate_readings(np.zeros((1, 4), int), np.zeros((1, 1)))


def test_what_is_lacking_has_a_reason_and_nothing_else_has():
    by_run = qa.load_calibration("sensor.h5")
    from_presses = qa.PressCalibration(issued_from_presses())
    for estimator, touches in (
        (by_run, by_run.estimate(by_run.issued.reference)),
        (
            from_presses,
            from_presses.estimate_readings(from_presses.issued.pairs, np.ones((2, 192)), differences=True),
        ),
    ):
        told = {
            Ability.FORCE: touches.force,
            Ability.FORCE_68: touches.force.within_68,
            Ability.FORCE_95: touches.force.within_95,
            Ability.STDERR: touches.force.stderr,
            Ability.DEPTH: touches.depth,
            Ability.REGION: touches.covariance_mm2,
            Ability.REGION_95: touches.radius_95_mm,
            Ability.DETECTABILITY: touches.detectability,
            Ability.SETTLING: touches.settled_in_s,
            Ability.SERIAL: estimator.identity.serial or None,
            Ability.FRAMES: estimator.pattern,
        }
        assert {ability for ability, value in told.items() if value is None} == set(told) & set(estimator.lacks)
        assert (estimator.regions is None) == (Ability.REGION in estimator.lacks)
        assert (touches.place_stderr_mm is None) == (Ability.STDERR in estimator.lacks)
        assert all(estimator.lacks.values())


def test_a_run_tells_the_same_in_apply_stream_and_python(folder):
    (recording,) = _apply()["recordings"]
    for one, told in zip(recording["frames"], _stream(), strict=True):
        assert (told.force_N, told.settled_in_s) == (one["force_N"], one["settled_in_s"])
        if told.touch:
            assert (told.x_mm, told.y_mm) == (one["x_mm"], one["y_mm"])
    frames = np.array([qa.load_calibration("sensor.h5").issued.reference])
    touches, forces = (
        qa.load_calibration("sensor.h5").estimate(frames),
        qa.Calibration.load("sensor.h5").force(frames),
    )
    assert np.array_equal(touches.force.values, forces.force_N)
    assert np.isnan(touches.settled_in_s).all()


def test_a_third_way_goes_through_apply_and_stream_as_rows_of_force(folder, monkeypatch):
    _use(monkeypatch)
    (recording,) = _apply()["recordings"]
    assert recording["remarks"] == ["learned from a batch"]
    messages = _stream()
    assert len(messages) == len(recording["frames"]) == _FRAMES
    for one, told in zip(recording["frames"], messages, strict=True):
        assert told.force_N == one["force_N"]
        assert told.force_68_N == (told.force_N - 0.5, told.force_N + 0.5)
        assert (told.force_95_N, told.radius_95_mm, told.settled_in_s) == (None, None, None)
        assert (one["stderr_N"], one["detectability"], one["settled_in_s"]) == (None, None, None)
        assert (told.x_mm, told.radius_68_mm) == ((one["x_mm"], 3.0) if told.touch else (None, None))
    assert {told.touch for told in messages} == {True, False}


def test_what_a_third_way_is_compared_with_is_handed_on_and_tables_need_regions(folder, monkeypatch):
    _use(monkeypatch)
    assert _apply("--differences")["recordings"][0]["remarks"] == ["learned from a batch", "differences"]
    assert _apply("--rest", "press.h5")["recordings"][0]["remarks"][1:] == [f"{_FRAMES} frames at rest"]
    done = CliRunner().invoke(app, ["calibration", "apply", "sensor.h5", "press.h5", "--pattern", "absent.csv"])
    assert "sensor.h5 states standard errors" in str(done.exception)


def test_a_third_way_with_regions_goes_through_apply_as_rows_of_places(folder, monkeypatch):
    _use(monkeypatch, regions=True)
    applied, messages = _apply(), _stream()
    assert (applied["q68"], applied["q95"]) == (2.3, None)
    for one, told in zip(applied["frames"], messages, strict=True):
        assert one["covariance_mm2"] == [[4.0, 0.0], [0.0, 1.0]]
        assert (one["force_N"], one["force_95_N"], one["modelled"]) == (told.force_N, None, None)
        assert one["in_model"] == told.touch
        assert one["flags"] == list(told.flags)
    table = CliRunner().invoke(app, ["calibration", "apply", "sensor.h5", "press.h5"])
    assert "68 % [mm]" in table.output
    written = CliRunner().invoke(app, ["calibration", "apply", "sensor.h5", "press.h5", "--output", "-"])
    assert "nan" not in written.output
    assert written.output.splitlines()[1].endswith("2.3,")


def test_what_a_third_way_cannot_tell_is_none_with_its_reason(folder, monkeypatch):
    _use(monkeypatch, force=False)
    estimator = qa.load_calibration("sensor.h5")
    assert estimator.estimate(estimator.issued.reference).force is None
    assert estimator.lacks[Ability.FORCE] == "was learned from sensors without load cells"
    assert {told.force_N for told in _stream()} == {None}
    (recording,) = _apply()["recordings"]
    assert {one["force_N"] for one in recording["frames"]} == {None}
    done = CliRunner().invoke(app, ["calibration", "apply", "sensor.h5", "press.h5", "--serial", "S-1"])
    assert "the calibration is of a batch" in str(done.exception)
