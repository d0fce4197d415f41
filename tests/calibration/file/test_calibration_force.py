"""The force model in a calibration: its way through the file, and refusal of what cannot be worked with."""

import dataclasses
from dataclasses import replace

import numpy as np
import pytest
from calibration_samples import edited, forged, sample_calibration, sample_force
from tiers import rest_but

from cbsr_qa.calibration.file.content import PREPARED
from cbsr_qa.calibration.file.hdf5 import read_calibration, stamp
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.results.calibration import ForceModel


def test_the_sample_says_something_in_every_field():
    """What a new field defaults to would come back even if no file held it; ``batch`` has a test of its own."""
    model = sample_force(18)
    defaults = {f.name: f.default for f in dataclasses.fields(ForceModel) if f.default is not dataclasses.MISSING}
    assert defaults
    assert [name for name, default in defaults.items() if getattr(model, name) == default] == ["batch"]


def _set(path, changes):
    with forged(path) as file:
        for name, value in changes.items():
            units, kind = "1", None
            if name in file:
                units, kind = file[name].attrs["units"], file[name].dtype
                del file[name]
            if value is not None:
                text = isinstance(value, str)
                made = file.create_dataset(name, data=value if text else np.asarray(value, dtype=kind))
                made.attrs["units"] = units


_HUGE = 10**6
_NODE = sample_force(18).node
_HOSTILE = {
    "node out of range": ({"force/node": np.full((7, 8), 51)}, "does not name each of 52 templates once"),
    "node below": ({"force/node": np.full((7, 8), -2)}, "does not name each"),
    "node named twice": ({"force/node": np.where(_NODE == 3, 4, _NODE)}, "does not name each"),
    "node of another shape": ({"force/node": np.zeros((8, 7))}, r"force/node of \(8, 7\)"),
    "no rows": ({"force/lattice/rows": 0}, "2 to 10000 are allowed"),
    "huge lattice": ({"force/lattice/columns": _HUGE, "force/lattice/rows": _HUGE}, "2 to 10000 are allowed"),
    "negative spacing": ({"force/lattice/spacing": -10.0}, "not positive"),
    "spacing NaN": ({"force/lattice/spacing": np.nan}, "force/lattice/spacing is nan; a finite number is expected"),
    "template NaN": (
        {"force/templates": np.full((52, 7), np.nan)},
        "force/templates holds a value that is not a finite",
    ),
    "templates long": ({"force/templates": np.ones((52, 7))}, "not of the length one"),
    "templates flat": ({"force/templates": np.ones(52)}, "force/templates has the shape"),
    "fewer templates": ({"force/templates": np.ones((9, 7)) / np.sqrt(7)}, "does not fit 9 nodes"),
    "map too short": ({"force/log_response": np.zeros(5)}, r"force/log_response of \(5,\) does not fit 52 nodes"),
    "map infinite": ({"force/log_response": np.full(52, np.inf)}, "force/log_response holds"),
    "error negative": ({"force/log_response_stderr": np.full(52, -1.0)}, "log_response_stderr is negative"),
    "merging of others": ({"force/merging": np.ones((7, 5))}, "force/merging is for 5 readings, 18 are used"),
    "merging of fewer": ({"force/merging": np.ones((6, 18))}, "does not fit 6 merged"),
    "merging NaN": ({"force/merging": np.full((7, 18), np.nan)}, "force/merging holds"),
    "gradient in one axis": ({"force/log_size_gradient": np.zeros((52, 1))}, r"log_size_gradient of \(52, 1\)"),
    "nowhere": ({"force/fits": np.zeros(52)}, "allows a head nowhere"),
    "threshold zero": ({"force/threshold": 0.0}, "out of range"),
    "scatter negative": ({"force/scatter": -0.1}, "force/scatter is negative"),
    "stress upside down": ({"force/stress": [9.0, 1.0]}, "out of range"),
    "missing map": ({"force/log_response": None}, "force/log_response is missing"),
    "missing reason": ({"force/none": None}, "force/none is missing"),
    "kernel of other shape": ({"force/loading/weights": [0.1, 0.2]}, "force/loading"),
    "kernel that grows": ({"force/loading/time_constants": [-1.0]}, "not positive and rising"),
    "slope zero": ({"quasi_static/against_stress/slope": 0.0}, "no force can be worked out from"),
    "current zero": ({"reference/current": 0.0}, "reference/current"),
    "reference NaN": ({"reference/voltages": np.full((6, 6), np.nan)}, "a used reading that is not a finite number"),
    "scale infinite": ({"reference/scale": np.inf}, "reference/scale is inf; a finite number is expected"),
    "radius without end": ({"validity/force": [1.0, np.inf]}, "validity/force holds a number that is infinite"),
    "band without end": ({"area_overlap/lower": [0.0, np.inf]}, "area_overlap/lower holds a number that is infinite"),
    "mean without end": ({"settling/mean": [np.inf, np.nan]}, "settling/mean holds a number that is infinite"),
    "size no exponential takes": ({"force/log_size": np.full(52, 99.0)}, "force/log_size holds 99; 50 is allowed"),
    "merging of no sensor": ({"force/merging": np.full((7, 18), 1e200)}, "force/merging holds 1e.200"),
    "nowhere to turn": ({"force/turning": np.zeros((52, 3))}, "force/turning is not positive definite"),
    "one place": ({"baseline_conductance/x": 1.0}, "baseline_conductance/x is one number where several"),
    "one count": ({"settling/accepted": 1}, "settling/accepted is one number where several"),
    "table of loads": ({"relaxation/stress/load": [[0]]}, "the content contradicts itself"),
    "reference of others": ({"reference/voltages": np.ones((5, 6))}, "not those of 6 drive and 6 measure pairs"),
}


#: Of each check of the model, and of what else a force is worked out from, one.
_ONE_OF_EACH = {
    "node out of range",
    "node of another shape",
    "huge lattice",
    "negative spacing",
    "spacing NaN",
    "template NaN",
    "templates long",
    "map too short",
    "error negative",
    "merging of others",
    "nowhere",
    "stress upside down",
    "missing map",
    "kernel that grows",
    "slope zero",
    "reference NaN",
    "radius without end",
    "size no exponential takes",
    "merging of no sensor",
    "nowhere to turn",
    "one place",
    "table of loads",
    "reference of others",
}


@pytest.mark.parametrize("what", rest_but(_ONE_OF_EACH, _HOSTILE))
def test_what_cannot_be_worked_with_is_refused_by_name_even_with_a_fitting_digest(issued, what):
    changes, said = _HOSTILE[what]
    _set(issued, changes)
    with pytest.raises(CalibrationError, match=said) as caught:
        read_calibration(issued)
    assert issued.name in caught.value.reason


def test_many_arrays_that_claim_too_much_together_are_refused_before_they_are_read(issued, monkeypatch):
    monkeypatch.setattr("cbsr_qa.calibration.file.hdf5_content.largest_content", lambda size_bytes: 2**20)
    assert read_calibration(issued).force is not None
    with edited(issued) as file:
        for number in range(3):
            shape = (2**19 // 8,)
            file.create_dataset(f"fill{number}", shape=shape, dtype="f8", chunks=(1000,)).attrs["units"] = "1"
    with pytest.raises(CalibrationError, match=r"fill1 of the shape \(65536,\) is empty or too large"):
        read_calibration(issued)


def test_templates_prepared_on_another_computer_change_the_digest_but_not_that_of_the_record():
    sample = sample_calibration()
    there = replace(sample.force, log_size=np.nextafter(sample.force.log_size, np.inf))
    shifted = replace(sample.force, log_size=sample.force.log_size + 1e-6)
    issued = stamp(sample)
    assert stamp(replace(sample, force=there)).digest == issued.digest  # rounding is not seen
    assert stamp(replace(sample, force=shifted)).digest != issued.digest
    assert stamp(replace(sample, force=shifted)).record_digest == issued.record_digest
    learned = replace(sample.force, log_response=sample.force.log_response + 1e-6)
    assert stamp(replace(sample, force=learned)).record_digest != issued.record_digest
    assert not any("force/log_response".startswith(path) for path in PREPARED)
