"""The load estimate against the Cramér–Rao bound, seeded and small; benchmarks/load_estimate.py has the grid."""

import numpy as np
import pytest
from drawn import drawn
from hypothesis import given, strategies as st

from benchmarks.load_bound import load_bound
from benchmarks.reference_solutions import fitted_mesh
from cbsr_qa.config.loader import load_sensor_type
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.readings.load_estimates import LoadFinding
from cbsr_qa.domain.sensor.patterns import DrivePattern
from cbsr_qa.eit.estimate.load_estimate import (
    DETECTED_GAIN,
    LEAST_DETECTABILITY,
    LoadEstimator,
    area_contrast,
    contrast_of,
    radius_of,
)
from cbsr_qa.eit.estimate.readings import load_model, merge_reciprocal
from cbsr_qa.eit.forward.model import ForwardModel
from cbsr_qa.eit.inverse.problem import NOMINAL_CONTACT_MM
from cbsr_qa.eit.loads.round_load import RoundLoads
from cbsr_qa.eit.mesh.sheet import sheet_mesh

SENSOR = load_sensor_type("disc-100mm").value
MODEL = load_model(SENSOR)
USED = SENSOR.pattern.usable()
UNLOADED = MODEL.solve_unloaded()
FOUND = {finding: number for number, finding in enumerate(LoadFinding)}


def readings(decibels: float, used: np.ndarray = USED):
    return merge_reciprocal(SENSOR.pattern, used, (10 ** (-decibels / 20) * UNLOADED) ** 2)


def estimator(decibels: float, *, known: bool, radius_mm: float = 6.5) -> LoadEstimator:
    return LoadEstimator(MODEL, readings(decibels), expected_radius_mm=radius_mm, known=known)


def change(x: float, y: float, radius: float, contrast: float) -> np.ndarray:
    loads = RoundLoads.from_contrast(np.array([[x, y]]), np.array([radius]), np.array([contrast]))
    return MODEL.readings(loads).change[0]


def meshed_change(x: float, y: float, radius: float, contrast: float) -> np.ndarray:
    """The same by finite elements, so that nothing is tested against itself."""
    mesh, inside = fitted_mesh(sheet_mesh(SENSOR, size_mm=3.0), (x, y), radius)
    contacts = np.full(SENSOR.electrodes.count, NOMINAL_CONTACT_MM)
    plain = ForwardModel(mesh, SENSOR.pattern, np.ones(len(mesh.elements)), contacts, order=2)
    return plain.with_values(conductance=1 + contrast * inside).voltages() - plain.voltages()


def noise(decibels: float, count: int, seed: int) -> np.ndarray:
    spread = 10 ** (-decibels / 20) * np.abs(UNLOADED[USED])
    return spread * np.random.default_rng(seed).standard_normal((count, spread.size))


def bound(decibels: float, x: float, y: float, *, known: bool, radius: float = 6.5, contrast: float = 0.18):
    return load_bound(
        MODEL, readings(decibels), x_mm=x, y_mm=y, radius_mm=radius, contrast=contrast, known=known
    )  # fmt: skip


def test_the_fisher_matrix_is_that_of_differences():
    at, steps = np.array([12.0, -17.0, 6.5, 0.3]), np.array([1e-3, 1e-3, 1e-3, 1e-5])
    merged = readings(60)
    slopes = np.stack(
        [
            (merged.merge_frames(change(*(at + step))) - merged.merge_frames(change(*(at - step)))) / (2 * size)
            for step, size in zip(np.diag(steps), steps, strict=True)
        ]
    )
    covariance = np.linalg.inv(slopes @ slopes.T)
    found = bound(60, *at[:2], known=False, contrast=at[3])
    assert found.place_mm == pytest.approx(np.sqrt(np.trace(covariance[:2, :2]) / 2), rel=1e-4)
    assert found.radius_stderr_mm == pytest.approx(np.sqrt(covariance[2, 2]), rel=1e-4)
    gradient = np.array([0, 0, 2 / at[2], 1 / at[3]])
    assert found.plain_area_contrast == pytest.approx(np.sqrt(gradient @ covariance @ gradient), rel=1e-4)
    known = np.linalg.inv((slopes @ slopes.T)[np.ix_([0, 1, 3], [0, 1, 3])])
    with_radius = bound(60, *at[:2], known=True, contrast=at[3])
    assert with_radius.contrast_stderr == pytest.approx(np.sqrt(known[2, 2]), rel=1e-4)
    assert with_radius.detectability == pytest.approx(np.linalg.norm(merged.merge_frames(change(*at))), rel=1e-12)


@pytest.mark.rest
@pytest.mark.parametrize(
    ("x", "y", "radius", "contrast", "decibels"),
    [
        (3.0, -2.0, 6.5, 0.18, 55),
        (0.0, 30.0, 6.5, 0.03, 70),
        (-25.0, 30.0, 4.0, 0.5, 60),
        (14.0, 15.0, 10.0, -0.2, 60),
    ],
)
def test_estimates_are_as_precise_as_the_bound_and_cover(x, y, radius, contrast, decibels):
    """600 trials: spread is known to 3 %, bias to 4 % of the bound, coverage to 2 %; four of those are allowed."""
    data = meshed_change(x, y, radius, contrast)[USED] + noise(decibels, 600, 5)
    for known in (True, False):
        limit = bound(decibels, x, y, known=known, radius=radius, contrast=contrast)
        found = estimator(decibels, known=known, radius_mm=radius).fit(data)
        assert (found.finding == FOUND[LoadFinding.LOCATED]).all()
        strength = radius**2 * contrast / (2 + contrast)
        wanted = np.array([x, y, strength, radius**2])
        free = np.arange(3 if known else 4)
        error = (found.fits.parameters - wanted)[:, free] / np.sqrt(np.diag(limit.covariance))[free]
        assert error.std(axis=0) == pytest.approx(np.ones(len(free)), abs=0.13)
        assert np.abs(error.mean(axis=0)).max() < 0.3
        own = (found.fits.parameters - wanted)[:, free] / np.sqrt(np.diagonal(found.fits.covariance, 0, 1, 2))[
            :, free
        ]
        assert (np.abs(own) <= 1).mean(axis=0) == pytest.approx(np.full(len(free), 0.683), abs=0.08)


@given(x=st.floats(-30, 30), y=st.floats(-30, 30), contrast=st.floats(0.05, 2.0), sign=st.sampled_from((-0.4, 1.0)))
@drawn(20)
def test_without_noise_the_load_itself_is_found_wherever_the_start(x, y, contrast, sign):
    data = change(x, y, 5.0, sign * contrast)[USED][None]
    for start in (None, np.array([[-x, -y]])):
        found = estimator(60, known=False).estimate(data, start_mm=start)[0]
        if found.detectability < 30:  # squares of the misfit left are then not far below a standard error's
            continue
        assert np.hypot(found.place_mm[0] - x, found.place_mm[1] - y) < 0.02 * found.place_stderr_mm
        assert found.misfit < 1e-3


def test_a_given_radius_gives_the_contrast_and_an_unknown_one_the_radius():
    data = meshed_change(20.0, 10.0, 6.5, 0.3)[USED][None]
    given_radius = estimator(60, known=True).estimate(data)[0]
    assert given_radius.contrast.value == pytest.approx(0.3, rel=2e-3)
    assert given_radius.radius_mm is None
    assert given_radius.no_radius == "the radius was given"
    unknown = estimator(60, known=False).estimate(data)[0]
    assert unknown.contrast is None
    assert unknown.radius_mm.value == pytest.approx(6.5, rel=0.02)
    mean_contrast = 2 * 0.3 / 2.3
    assert unknown.area_contrast_mm2.value == pytest.approx(np.pi * 6.5**2 * mean_contrast, rel=5e-3)


def test_noise_alone_is_not_detected():
    found = estimator(60, known=False).fit(noise(60, 2000, 11))
    assert (found.finding == FOUND[LoadFinding.NOT_DETECTED]).mean() >= 0.998
    assert not (found.finding == FOUND[LoadFinding.LOCATED]).any()
    refused = estimator(60, known=True).estimate(noise(60, 1, 12))[0]
    assert refused.place_mm is None
    assert refused.area_contrast_mm2 is None
    assert "no load stands out" in refused.why


def test_a_weak_load_is_detected_but_not_placed_and_told_what_would_help():
    contrast = 0.18 * 6.5 / bound(40, 0.0, 0.0, known=True).detectability  # d′ of about 6.5
    data = change(0.0, 0.0, 6.5, contrast)[USED] + noise(40, 300, 2)
    found = estimator(40, known=True).fit(data)
    assert (found.finding == FOUND[LoadFinding.NOT_RESOLVABLE]).mean() > 0.7
    assert (found.finding == FOUND[LoadFinding.LOCATED]).mean() < 0.12
    one = estimator(40, known=True).estimate(change(0.0, 0.0, 6.5, contrast)[USED][None])[0]
    assert one.finding is LoadFinding.NOT_RESOLVABLE
    assert 5 < one.detectability < LEAST_DETECTABILITY
    assert "averaging" in one.why
    assert one.detectability**2 > DETECTED_GAIN


def test_a_radius_the_readings_do_not_determine_is_refused_with_the_size_that_would_be():
    one = estimator(50, known=False).estimate(change(0.0, 0.0, 6.5, 0.18)[USED][None])[0]
    assert one.finding is LoadFinding.LOCATED
    assert one.radius_mm is None
    needed = float(one.no_radius.split("from ")[1].split(" mm")[0])
    assert (
        bound(50, 0.0, 0.0, known=False, radius=needed, contrast=0.18 * (6.5 / needed) ** 2).radius_stderr_mm
        < needed / 2.5
    )
    assert one.area_contrast_mm2 is not None


def test_two_loads_are_no_round_load_and_get_no_place():
    both = change(-20.0, 0.0, 6.5, 0.3) + change(20.0, 12.0, 6.5, 0.3)
    one = estimator(60, known=True).estimate(both[USED][None])[0]
    assert one.finding is LoadFinding.NOT_AS_MODELLED
    assert one.misfit > 5
    assert one.misfit_probability < 1e-6
    assert one.inflation == pytest.approx(one.misfit, rel=1e-6)
    assert one.explained < 0.8
    assert f"explains {one.explained:.0%}" in one.why
    alone = estimator(60, known=True).estimate(change(-20.0, 0.0, 6.5, 0.3)[USED][None])[0]
    assert alone.inflation == 1
    assert alone.explained == alone.explained_unweighted == 1


def test_a_small_misfit_widens_the_uncertainty():
    """Readings that a gain error of 5 % each turns into those of no round load, far above the noise."""
    gains = 1 + 0.05 * np.random.default_rng(5).standard_normal(USED.sum())
    data = change(-20.0, 0.0, 6.5, 0.5)[USED]
    exact, off = estimator(80, known=True).estimate(np.stack([data, gains * data]))
    assert off.finding is LoadFinding.LOCATED
    assert 0.95 < off.explained < 1
    assert off.inflation > 10
    assert off.place_stderr_mm == pytest.approx(exact.place_stderr_mm * np.sqrt(off.inflation), rel=0.2)


def test_shares_of_the_signal_leave_out_noise():
    """Noise as large as the signal leaves half of the squares; without it all is explained."""
    data = np.tile(change(10.0, -15.0, 6.5, 0.3)[USED], (400, 1))
    found = estimator(35, known=True).fit(data + noise(35, 400, 6))
    assert np.median(found.fits.misfit / found.fits.empty_misfit) > 0.3
    assert np.median(found.explained) > 0.95
    assert (found.finding == FOUND[LoadFinding.NOT_AS_MODELLED]).mean() < 0.02


def test_masked_readings_cost_precision_and_no_bias():
    used = USED.copy()
    used[:3] = used[:, :3] = False  # three drive pairs and as many measure pairs
    data = change(10.0, -20.0, 6.5, 0.3)
    merged = readings(60, used)
    left = LoadEstimator(MODEL, merged, expected_radius_mm=6.5, known=True).estimate(data[used][None])[0]
    whole = estimator(60, known=True).estimate(data[USED][None])[0]
    assert np.hypot(left.place_mm[0] - 10, left.place_mm[1] + 20) < 0.02 * left.place_stderr_mm
    assert left.place_stderr_mm > 1.1 * whole.place_stderr_mm


def test_places_are_as_uncertain_as_stated_whatever_electrodes_are_missing():
    """The more electrodes are missing, the larger the errors; the regions hold."""
    random = np.random.default_rng(17)
    noise_V, errors = 2e-4 * np.abs(UNLOADED[USED]).max(), []
    places = random.uniform(-24, 24, (80, 2))
    loads = RoundLoads.from_contrast(places, np.full(80, 6.5), np.full(80, 0.5))
    frames = MODEL.readings(loads).change + noise_V * random.standard_normal((80, *USED.shape))
    for missing in ((), (3, 9), (0, 5, 6, 12), (1, 4, 7, 8, 13)):
        used = USED & ~SENSOR.pattern.touching(missing)
        merged = merge_reciprocal(SENSOR.pattern, used, np.full(used.shape, noise_V**2))
        found = LoadEstimator(MODEL, merged, expected_radius_mm=6.5, known=True).estimate(frames[:, used])
        off = np.array([each.place_mm for each in found]) - places
        squares = [
            one @ np.linalg.solve(each.place_covariance_mm2, one) for one, each in zip(off, found, strict=True)
        ]
        # Shares of 80: standard errors of 5 and 2.4 %.
        assert np.mean(np.array(squares) <= 2.279) == pytest.approx(0.68, abs=0.16)
        assert np.mean(np.array(squares) <= 5.991) == pytest.approx(0.95, abs=0.08)
        errors.append(np.median(np.hypot(*off.T)))
    assert (np.diff(errors) > 0).all()


def test_readings_merge_by_reciprocity_without_loss():
    merged = readings(60)
    assert len(merged.weight) == 104
    frame = change(10.0, 3.0, 6.5, 0.3)
    assert np.allclose(merged.merge_changes(frame[USED][None])[0], merged.merge_frames(frame), rtol=1e-9)
    rows = merged.merge_changes(noise(60, 4000, 3))
    assert np.abs(np.cov(rows.T) - np.eye(104)).max() < 0.12


def test_reversed_pairs_merge_with_their_sign():
    turned = DrivePattern(16, SENSOR.pattern.drive, tuple((b, a) for a, b in SENSOR.pattern.measure))
    merged = merge_reciprocal(turned, turned.usable(), np.ones(turned.shape))
    frame = -change(10.0, 3.0, 6.5, 0.3)
    assert len(merged.weight) == 104
    assert np.allclose(merged.merge_changes(frame[turned.usable()][None])[0], merged.merge_frames(frame), atol=1e-12)


def test_the_radius_is_never_negative_and_its_bias_is_of_fourth_order():
    rng = np.random.default_rng(0)
    for square in (3.0, 4.0, 6.0):
        found = np.mean([radius_of(q, 1.0).value for q in rng.normal(square, 1.0, 20_000)])
        assert abs(found - np.sqrt(square)) < 0.05 / (2 * np.sqrt(square))
    below = radius_of(-2.0, 1.0)
    assert below.value > 0
    assert below.low == below.high - below.high == 0.0


def test_a_radius_held_by_an_electrode_ends_there():
    held = radius_of(49.0, 10.0, 15.0)
    free = radius_of(49.0, 10.0)
    assert held.high == pytest.approx(max(7.0, held.value))
    assert free.low < held.low < 7.0


def test_quantities_follow_from_strength_and_square():
    assert area_contrast(2.0, 0.1).value == pytest.approx(4 * np.pi)
    contrast = contrast_of(0.3 / 2.3, 1e-4)
    assert contrast.value == pytest.approx(0.3)
    assert contrast.high - contrast.low == pytest.approx(2 * contrast.stderr, rel=1e-3)
    assert contrast_of(0.99, 0.2).high == pytest.approx(2 * 0.98 / 0.02)  # κ of μ = 0.98, the largest that counts


def test_impossible_input_is_refused():
    merged = readings(60)
    good = estimator(60, known=True)
    with pytest.raises(NumericsError, match="do not match"):
        good.estimate(np.zeros((1, 5)))
    with pytest.raises(NumericsError, match="not a finite"):
        good.estimate(np.full((1, 208), np.nan))
    with pytest.raises(NumericsError, match="does not fit on the sheet"):
        LoadEstimator(MODEL, merged, expected_radius_mm=60.0, known=True)
    with pytest.raises(NumericsError, match="positive finite"):
        merge_reciprocal(SENSOR.pattern, USED, np.zeros(SENSOR.pattern.shape))
    with pytest.raises(NumericsError, match="independent readings"):
        merge_reciprocal(SENSOR.pattern, USED & (np.arange(256).reshape(16, 16) < 12), np.ones(SENSOR.pattern.shape))
    with pytest.raises(NumericsError, match="do not match frames"):
        merge_reciprocal(SENSOR.pattern, USED[:3], np.ones(SENSOR.pattern.shape))


def test_the_answer_does_not_depend_on_what_else_is_asked():
    data = change(18.0, -9.0, 6.5, 0.2)[USED] + noise(60, 5, 8)
    others = change(-30.0, 5.0, 8.0, 0.5)[USED] + noise(60, 5, 9)
    alone = estimator(60, known=False).estimate(data)
    among = estimator(60, known=False).estimate(np.vstack([others, data]))[5:]
    for one, other in zip(alone, among, strict=True):
        assert one.place_mm == pytest.approx(other.place_mm, abs=1e-3 * one.place_stderr_mm)


def test_no_place_is_reported_with_nan_or_beside_a_refusal():
    for contrast in (0.002, 0.01, 0.05, 0.5):
        for found in estimator(45, known=False).estimate(change(25.0, 25.0, 6.5, contrast)[USED] + noise(45, 20, 4)):
            located = found.finding is LoadFinding.LOCATED
            assert (found.place_mm is not None) == located == (found.area_contrast_mm2 is not None)
            assert located or (found.why and found.radius_mm is None)
            if located:
                assert np.isfinite(found.place_covariance_mm2).all()
                assert (np.linalg.eigvalsh(found.place_covariance_mm2) > 0).all()
