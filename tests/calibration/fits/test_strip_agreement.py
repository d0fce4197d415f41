"""A sheet against a strip of its material: kernels with errors, and what is claimed of equal and unequal ones."""

from dataclasses import replace

import numpy as np
import pytest
from simulated_runs import observed_run, simulated_run
from strip_samples import Truth, readings, specimen

from cbsr_qa.analysis.run.agreement import sheet_against_strip
from cbsr_qa.calibration.fits.agreement import Agreement, compare_relaxations
from cbsr_qa.calibration.fits.kernel_curve import KernelCurve
from cbsr_qa.calibration.strip.characterisation import characterise
from cbsr_qa.config.loader import load_material
from cbsr_qa.domain.plan.analysis_settings import CharacterisationSettings
from cbsr_qa.domain.results.report import Figure, Paragraph
from cbsr_qa.domain.sensor.sensor_type import MeasuredKernel, Relaxation
from cbsr_qa_plugins.metrics.relaxation import SheetAndStripRelaxation
from cbsr_qa_plugins.sections.relaxation import _agreements

MATERIAL = load_material("cbsr-8wt").value
PLACES = ((0.0, 0.0), (30.0, 0.0), (-15.0, 15.0), (0.0, -30.0), (15.0, 15.0))
TIME_S = np.array([1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 50.0])


@pytest.fixture(scope="module")
def strip():
    """Twelve cycles with the shipped noise, as a material file carries them."""
    return characterise(readings(Truth(), count=4), specimen(), CharacterisationSettings()).relaxation


@pytest.fixture(scope="module")
def alike(strip):
    """A sheet of the strip's material."""
    return observed(replace(MATERIAL, strip_relaxation=strip))


def observed(material, **options):
    return observed_run(simulated_run(PLACES, material=material, **options), calibrate_phases=("grid",))


def exponentials(kernel, time_s):
    return sum(w * np.exp(-time_s / tau) for w, tau in zip(kernel.weights, kernel.time_constants_s, strict=True))


def known(weights, time_constants_s, stderr=0.02):
    covariance = tuple(tuple(row) for row in (stderr**2 * np.eye(2 * len(weights))).tolist())
    return MeasuredKernel(tuple(weights), tuple(time_constants_s), covariance, 0.5, 60.0)


# --- the strip's kernels ---


def test_the_strips_kernels_are_its_materials_within_their_errors(strip):
    release = KernelCurve.from_release(strip.loading, strip.unloading, 1e4)
    for found, true in (
        (KernelCurve.from_press(strip.loading), 1 + exponentials(MATERIAL.loading_relaxation, TIME_S)),
        (release, -exponentials(MATERIAL.unloading_relaxation, TIME_S)),
    ):
        curve, variance = found.relative(TIME_S)
        assert np.abs((curve - true) / np.sqrt(variance)).max() < 3.5
        assert np.sqrt(variance).max() < 0.02
    assert (strip.cycles, strip.least_strain, strip.largest_strain) == (12, 0.1, 0.3)
    assert strip.source == "test"


def test_a_release_after_a_hold_is_what_superposition_says():
    """The unit step is held, then taken away; its answer, over the change at the end of the hold."""
    loading, unloading, hold_s = known((-0.2, -0.55), (2.5, 23.1)), known((0.2, 0.62), (2.5, 25.4)), 20.0
    left = (1 + exponentials(loading, hold_s + TIME_S)) - (1 - exponentials(unloading, TIME_S))
    curve = KernelCurve.from_release(loading, unloading, hold_s)
    assert curve.relative(TIME_S)[0] == pytest.approx(left / (1 + exponentials(loading, hold_s)), rel=1e-12)
    long = KernelCurve.from_release(loading, unloading, 1e4)
    assert long.relative(TIME_S)[0] == pytest.approx(exponentials(unloading, TIME_S), rel=1e-12)


@pytest.mark.rest
def test_its_error_is_that_of_kernels_drawn_from_their_covariance():
    loading, unloading = known((-0.2, -0.55), (2.5, 23.1)), known((0.2, 0.62), (2.5, 25.4))
    random = np.random.default_rng(1)

    def drawn(kernel):
        weights, log_s = 0.02 * random.standard_normal((2, 2))
        moved = np.array(kernel.time_constants_s) * np.exp(log_s)
        return replace(kernel, weights=tuple(kernel.weights + weights), time_constants_s=tuple(moved))

    curves = [KernelCurve.from_release(drawn(loading), drawn(unloading), 20.0) for _ in range(4000)]
    spread = np.std([curve.relative(TIME_S)[0] for curve in curves], axis=0)
    whole = KernelCurve.from_release(loading, unloading, 20.0)
    assert np.sqrt(whole.relative(TIME_S)[1]) == pytest.approx(spread, rel=0.06)
    times = [curve.settling_time(0.15)[0] for curve in curves]
    settled, stderr = whole.settling_time(0.15)
    assert settled == pytest.approx(np.mean(times), rel=0.02)
    assert stderr == pytest.approx(np.std(times), rel=0.1)


def test_settling_is_the_last_time_outside():
    (found, _), exact = KernelCurve.from_press(known((0.5,), (10.0,))).settling_time(0.15), 10 * np.log(0.5 / 0.15)
    assert found == pytest.approx(exact, rel=1e-9)
    (falling, _) = KernelCurve.from_press(known((-0.5,), (10.0,))).settling_time(0.15)
    assert falling == pytest.approx(exact, rel=1e-9)
    # It crosses zero, and leaves the band again to the other side.
    twice = known((1.0, -0.5), (2.0, 20.0))
    late, _ = KernelCurve.from_press(twice).settling_time(0.15)
    assert exponentials(twice, late) == pytest.approx(-0.15, rel=1e-9)
    assert KernelCurve.from_press(known((0.1,), (10.0,))).settling_time(0.15) is None
    assert KernelCurve.from_press(known((0.9,), (100.0,))).settling_time(0.15) is None


def test_relaxations_without_common_time_are_not_compared():
    early, late = known((0.5,), (10.0,)), replace(known((0.5,), (10.0,)), start_s=70.0, window_s=90.0)
    found = compare_relaxations(KernelCurve.from_press(early), KernelCurve.from_press(late))
    assert found.why == "no time in common: one begins at 70 s, one ends at 60 s"
    assert found.shape is found.time is Agreement.UNDECIDED


# --- sheets ---


def test_a_sheet_of_the_strips_material_is_equivalent(alike):
    found = {(m.name, m.qualifier): m for m in SheetAndStripRelaxation().measure_run(alike)}
    assert len(found) == 8
    for direction in ("loading", "unloading"):
        difference = found["strip_relaxation_difference", direction]
        assert abs(difference.value) < 3.5 * difference.uncertainty
        assert found["strip_relaxation_difference_bound", direction].value < 0.1
        ratio = found["strip_relaxation_time_ratio", direction]
        assert abs(ratio.value - 1) < 3.5 * ratio.uncertainty
        bound = found["strip_relaxation_time_bound", direction].value
        assert max(ratio.value, 1 / ratio.value) < bound
        assert ratio.how.startswith("equivalent") == (bound <= 1.2)


@pytest.mark.rest
def test_a_sheet_that_relaxes_otherwise_is_different(strip):
    """Twice as fast under load, and half as much after it."""
    other = replace(
        MATERIAL,
        strip_relaxation=strip,
        loading_relaxation=Relaxation((-0.20, -0.55), (2.5, 11.5), "test"),
        unloading_relaxation=Relaxation((-0.10, -0.30), (2.5, 25.4), "test"),
    )
    loading, unloading = sheet_against_strip(observed(other))
    assert loading.found.shape is loading.found.time is Agreement.DIFFERENT
    assert loading.found.time_ratio == pytest.approx(0.5, abs=0.1)
    assert loading.found.shape_difference > 0.1
    assert unloading.found.shape is Agreement.DIFFERENT
    assert unloading.found.shape_difference < -0.1


@pytest.mark.parametrize(
    ("missing", "why"),
    [
        ("both", "not compared: material cbsr-8wt has no strip relaxation; characterise a strip of its batch"),
        ("unloading", "not compared: the material file has no strip relaxation in this direction"),
    ],
)
def test_without_a_strip_there_is_no_value_and_the_reason(alike, strip, missing, why):
    kept = None if missing == "both" else replace(strip, unloading=None)
    run = replace(alike, record=replace(alike.record, material=replace(MATERIAL, strip_relaxation=kept)))
    found = [m for m in SheetAndStripRelaxation().measure_run(run) if m.value is None]
    assert len(found) == (8 if missing == "both" else 4)
    assert {m.how for m in found} == {why}


def test_without_a_force_model_there_is_no_value_and_the_reason(strip):
    material = replace(MATERIAL, strip_relaxation=strip)
    run = observed_run(simulated_run(PLACES[:1], material=material, hold_s=20.0, rest_s=5.0), calibrate_phases=())
    assert {m.value for m in SheetAndStripRelaxation().measure_run(run)} == {None}
    assert all("the sheet has no relaxation: " in m.how for m in SheetAndStripRelaxation().measure_run(run))


def test_the_report_draws_the_agreement_that_was_asked_for(alike, strip):
    measured = SheetAndStripRelaxation().measure_run(alike)
    (drawn,) = _agreements(alike, measured)
    assert isinstance(drawn, Figure)
    assert "equivalent" in drawn.svg
    assert "The sheet against a strip of its material" in drawn.caption
    assert list(_agreements(alike, ())) == []
    bare = replace(alike, record=replace(alike.record, material=MATERIAL))
    (told,) = _agreements(bare, SheetAndStripRelaxation().measure_run(bare))
    assert isinstance(told, Paragraph)
    assert "not compared, material cbsr-8wt has no strip relaxation" in told.text
