"""Baseline conductance of a load and of a location (Eq 7), its error, and what is left out and why."""

from dataclasses import replace

import numpy as np
import pytest
from observation_samples import INDENTER, sample_load, sample_material

from cbsr_qa.calibration.sheet.baseline import (
    LoadBaseline,
    baseline_conductance,
    load_baseline,
    location_baseline,
    predict_change,
)
from cbsr_qa.domain.imaging import Image
from cbsr_qa.domain.sensor.sensor_type import Parameter, QuasiStatic, Response

STRESS = sample_material().against_stress
QUIET = np.zeros((8, 180))


def _mirrored(fit: QuasiStatic) -> QuasiStatic:
    """The fit of a material that conducts less by as much as this one conducts more."""
    slope, intercept = (replace(part, value=-part.value) for part in (fit.slope, fit.intercept))
    return QuasiStatic(slope, intercept, fit.covariance)


def _material(intercept: float, slope_error: float, covariance: float | None = None) -> QuasiStatic:
    return QuasiStatic(Parameter(4.5e-3, slope_error, "test"), Parameter(intercept, 0.01, "test"), covariance)


def test_a_load_gives_change_over_predicted_change():
    load = sample_load(change=0.03, force_N=3.0)
    found = load_baseline(load, STRESS, QUIET, 0.85)
    predicted = 4.5e-3 * 3.0 / INDENTER.area_mm2 * 1e3
    assert found.value == pytest.approx(0.03 / predicted, rel=1e-12)


def test_a_material_that_conducts_less_under_load_gives_the_same():
    noise = 1e-3 * np.random.default_rng(2).standard_normal((8, 180))
    rising = load_baseline(sample_load(), STRESS, noise, 0.85)
    falling = load_baseline(sample_load(response=Response.DECREASE), _mirrored(STRESS), -noise, 0.85)
    assert falling == rising
    assert rising.value > 0
    assert rising.stderr > 0


def test_the_change_is_averaged_by_area():
    load = sample_load()
    mesh = load.image.mesh
    values = np.linspace(0.01, 0.05, len(mesh.elements))
    found = load_baseline(replace(load, image=Image(mesh, values)), STRESS, QUIET, 0.85)
    expected = values @ mesh.areas_mm2 / mesh.areas_mm2.sum()
    assert found.value * predict_change(STRESS, load.stress_kPa)[0] == pytest.approx(expected, rel=1e-12)


def test_the_error_is_that_of_image_noise_and_force():
    load = sample_load(change=0.03, force_N=3.0)
    noise = np.where(np.arange(8)[:, None] % 2 == 0, 1e-3, -1e-3) * np.ones((8, 180))
    found = load_baseline(load, STRESS, noise, 0.85)
    expected = np.hypot(1e-3 / np.sqrt(4) / 0.03, 0.01 / 3.0)
    assert found.stderr / found.value == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(
    ("load", "fit", "said"),
    [
        ({"blob_mm": None}, STRESS, "no blob"),
        ({"force_N": None}, STRESS, "no force"),
        ({"force_N": 0.0}, STRESS, "not clear of zero"),
        ({"change": -0.03}, STRESS, "sign"),
        ({"force_N": 0.7}, _material(0.0, 0.0), "not clear of zero"),  # 5.3 kPa: α σ = 0.024 ± 0.010
        ({"force_N": 1.0}, _material(-0.033, 0.0), "not clear of zero"),
        ({"response": Response.DECREASE}, STRESS, "conduct more; the response of this run is that they do less"),
        ({}, _mirrored(STRESS), "conduct less; the response of this run is that they do more"),
    ],
)
def test_loads_that_say_nothing_are_left_out_with_the_reason(load, fit, said):
    found = load_baseline(sample_load(**load), fit, QUIET, 0.85)
    assert found.value is found.stderr is None
    assert said in found.why
    assert load_baseline(sample_load(force_N=1.0), _material(0.0, 0.0), QUIET, 0.85).value is not None


def test_slope_and_intercept_that_err_together_err_less():
    alone = predict_change(_material(0.0, 1e-3), 20.0)
    together = predict_change(_material(0.0, 1e-3, -0.9 * 1e-3 * 0.01), 20.0)
    assert alone[0] == together[0]
    assert together[1] == pytest.approx(np.sqrt(0.02**2 + 0.01**2 - 2 * 20 * 0.9e-5))
    assert together[1] < alone[1]


@pytest.mark.parametrize(
    ("settled", "said"), [(True, ""), (False, "before 1.5 settling times"), (None, "no settling time is known")]
)
def test_a_load_that_was_not_or_may_not_have_been_settled_is_used_and_marked(settled, said):
    found = load_baseline(replace(sample_load(), settled=settled), STRESS, QUIET, 0.85)
    assert found.value is not None
    assert said in found.why
    assert bool(found.why) is bool(said)


def test_a_location_is_the_mean_with_the_larger_of_both_errors():
    scattered = location_baseline("L0", 0.0, 0.0, [LoadBaseline(v, 0.001) for v in (0.30, 0.32, 0.34)])
    assert scattered.value == pytest.approx(0.32)
    assert scattered.stderr == pytest.approx(0.02 / np.sqrt(3))
    assert scattered.loads == 3
    steady = location_baseline("L0", 0.0, 0.0, [LoadBaseline(0.3, 0.01)] * 4)
    assert steady.stderr == pytest.approx(0.005)
    single = location_baseline("L0", 0.0, 0.0, [LoadBaseline(0.3, 0.01)])
    assert (single.value, single.stderr, single.loads) == (0.3, 0.01, 1)


def test_a_location_without_any_answer_says_why():
    nothing = location_baseline("L3", 15.0, 15.0, [LoadBaseline(None, None, "no blob was sensed")] * 2)
    assert (nothing.value, nothing.stderr, nothing.loads) == (None, None, 0)
    assert nothing.why == "no blob was sensed"


def test_loads_are_gathered_by_place():
    loads = [
        sample_load("L0", trial=0),
        sample_load("L1", (30.0, 0.0), blob_mm=(30.0, 0.0, 6.5)),
        sample_load("L0", trial=1, change=0.032),
    ]
    first, second = baseline_conductance(loads, STRESS, QUIET, 0.85)
    assert (first.location, first.loads, second.location, second.loads) == ("L0", 2, "L1", 1)
    assert first.value == pytest.approx(second.value * 0.031 / 0.03)
