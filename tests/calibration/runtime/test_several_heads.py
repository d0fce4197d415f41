"""Several heads in one frame: found, told apart, or said not to be; with the field of each bent by the others."""

from dataclasses import replace

import numpy as np
import pytest
from force_samples import HEAD, in_use, learned, line, pressed, setting, smooth_response, somewhere
from mpmath import mp

from cbsr_qa.calibration.force.inverse import Flag, SizeError
from cbsr_qa.calibration.force.multi_load import HeadCounter, _inverse_root
from cbsr_qa.config.loader import load_material, load_sensor_type
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.plan.world import SheetDesign
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.eit.loads.round_load import RoundLoads
from cbsr_qa.simulate.sheet import SimulatedSheet

NOISE = 2.4e-5


@pytest.fixture(scope="module")
def response():
    return smooth_response(5, 0.2)


@pytest.fixture(scope="module")
def calibration(response):
    random = np.random.default_rng(2)
    result = learned(pressed(random, response, somewhere(random, 40), random.uniform(1.5, 5, 40)))
    return in_use(result.model, result.line)


@pytest.fixture(scope="module")
def sheet(response):
    """Finite elements in which all heads press together: fields are not those of single heads added up."""
    design = SheetDesign.make_uniform(load_sensor_type("disc-100mm").value, HEAD)
    design.response.append(response)
    ohm = load_material("cbsr-8wt").value.interelectrode_resistance_ohm.value
    return SimulatedSheet(design, size_mm=5.0, interelectrode_resistance_ohm=ohm)


def frame(sheet, places_mm, force_N, random, noise=1.0):
    changes = {
        (float(x), float(y)): line().slope.value * newtons / HEAD.area_mm2 * 1e3 + line().intercept.value
        for (x, y), newtons in zip(places_mm, force_N, strict=True)
    }
    # The change alone: mesh and expansion do not share their unloaded readings to the last digits of a change.
    change = (sheet.voltages(changes) - sheet.unloaded) * sheet.conductance_S
    return setting().model.solve_unloaded() + change + noise * NOISE * random.standard_normal(change.shape)


def pairs(random, distance_mm, count, radius_mm=36.0):
    while count:
        middle, angle = somewhere(random, 1, radius_mm)[0], random.uniform(0, np.pi)
        way = distance_mm / 2 * np.array([np.cos(angle), np.sin(angle)])
        places = np.array([middle + way, middle - way])
        if np.hypot(*places.T).max() < radius_mm:
            count -= 1
            yield places, random.uniform(1.5, 5.0, 2)


def test_slopes_of_templates_are_those_of_differences(calibration):
    places, step = np.array([[5.3, 7.1], [-20.2, 11.0], [33.0, -4.0]]), 1e-3
    found = calibration.filter.template_and_slopes(places)
    np.testing.assert_allclose(found[:, 0], calibration.filter.template(places), rtol=1e-12)
    for axis, shift in enumerate(np.eye(2) * step, start=1):
        ahead, behind = (calibration.filter.template(places + sign * shift) for sign in (1, -1))
        expected = (ahead - behind) / (2 * step)
        np.testing.assert_allclose(found[:, axis], expected, atol=1e-5 * np.abs(expected).max())
    assert np.isnan(calibration.filter.template_and_slopes(np.array([[49.9, 0.0]]))).all()


@pytest.mark.rest
def test_two_heads_are_told_apart_with_honest_errors(calibration, sheet):
    random = np.random.default_rng(8)
    scaled, single = [], []
    for places, force in pairs(random, 25.0, 20):
        seen = frame(sheet, places, force, random)
        (found,) = calibration.forces(seen)
        assert not found.flags
        near = np.hypot(*(found.loads.place_mm[:, None] - places).transpose(2, 0, 1)).argmin(axis=1)
        assert sorted(near) == [0, 1]
        scaled += list((found.loads.force_N - force[near]) / found.loads.stderr_N)
        assert found.total_N == pytest.approx(force.sum(), abs=4 * found.total_stderr_N)
        one = calibration.force(seen)
        single.append(bool(one.flags[0] & Flag.MORE_THAN_ONE))
        assert abs(one.force_N[0] - force.sum()) < 3 * one.stderr_N[0]
    assert all(single)
    assert 0.6 < np.sqrt(np.mean(np.square(scaled))) < 1.5


@pytest.mark.rest
def test_two_heads_side_by_side_are_never_one_and_their_sum_is_right(calibration, sheet):
    random = np.random.default_rng(9)
    for places, force in pairs(random, 15.0, 12, radius_mm=33.0):
        (found,) = calibration.forces(frame(sheet, places, force, random))
        assert len(found.loads.force_N) == 2 or found.flags & Flag.MORE_THAN_ONE
        assert found.total_N == pytest.approx(force.sum(), rel=0.08)
        assert abs(found.total_N - force.sum()) < 4 * found.total_stderr_N


@pytest.mark.rest
def test_one_head_is_one(calibration, sheet):
    random = np.random.default_rng(10)
    for place in somewhere(random, 25, 38.0):
        force = random.uniform(1.5, 5.0, 1)
        seen = frame(sheet, [place], force, random)
        (found,) = calibration.forces(seen)
        assert (len(found.loads.force_N), found.flags) == (1, Flag(0))
        one = calibration.force(seen)
        assert one.flags[0] == 0
        assert found.loads.force_N == pytest.approx(one.force_N, rel=0.01)
        assert found.total_stderr_N == pytest.approx(one.stderr_N[0], rel=0.3)


def test_three_heads_far_apart_are_three(calibration, sheet):
    random = np.random.default_rng(11)
    places, force = np.array([[28.0, 0.0], [-14.0, 24.0], [-14.0, -24.0]]), np.array([2.0, 3.0, 4.0])
    (found,) = calibration.forces(frame(sheet, places, force, random))
    order = np.argsort(found.loads.force_N)
    assert found.loads.force_N[order] == pytest.approx(force, abs=0.4)
    assert np.hypot(*(found.loads.place_mm[order] - places).T).max() < 2
    (two,) = calibration.forces(frame(sheet, places, force, random), at_most=2)
    assert two.flags == Flag.MORE_THAN_ONE
    assert (two.loads.flags & Flag.MORE_THAN_ONE).all()
    assert abs(two.total_N - force.sum()) < 3 * two.total_stderr_N


@pytest.mark.parametrize("each_N", [0.1, 0.5])
def test_a_whole_hand_is_more_than_one(calibration, sheet, each_N):
    """Thirty-seven loads over the whole sheet."""
    lattice = np.stack(np.meshgrid(*[np.arange(-36.0, 37.0, 12.0)] * 2), axis=-1).reshape(-1, 2)
    places = lattice[np.hypot(*lattice.T) < 41]
    seen = frame(sheet, places, np.full(len(places), each_N), np.random.default_rng(12))
    assert calibration.force(seen).flags[0] & Flag.MORE_THAN_ONE
    (found,) = calibration.forces(seen)
    assert found.flags & Flag.MORE_THAN_ONE
    assert abs(found.total_N - each_N * len(places)) < 3 * found.total_stderr_N


def test_noise_and_frames_that_cannot_be_used_hold_no_head(calibration):
    here, random = setting(), np.random.default_rng(13)
    light = here.model.solve_unloaded()
    noise = light + NOISE * random.standard_normal((200, *light.shape))
    nothing = calibration.forces(noise)
    assert [len(found.loads.force_N) for found in nothing] == [0] * 200
    assert {found.flags for found in nothing} == {Flag.NOT_DETECTED}
    assert {(found.total_N, found.total_stderr_N) for found in nothing} == {(0.0, calibration.least_force_N)}
    (foreign,) = calibration.forces(3 * light)
    assert foreign.flags == Flag.OTHER_SENSOR
    assert np.isnan(foreign.total_N)


def test_the_fit_of_exact_sums_is_exact(calibration):
    """Rows made of two templates without noise: places and strengths come back."""
    filter_ = calibration.filter
    places, strength = np.array([[10.0, 5.0], [-12.0, -8.0]]), np.array([0.05, 0.09])
    rows = strength @ filter_.template(places)
    counter = HeadCounter(filter_, threshold=5.0, misfit=1e-3, diameter_mm=13.0)
    found, further = counter.heads(rows, np.array([-11.0, -8.0]), 3)
    assert (len(found), further) == (2, 0.0)
    order = np.argsort(found.strength)
    assert found.strength[order] == pytest.approx(strength, rel=1e-3)
    np.testing.assert_allclose(found.place_mm[order], places, atol=0.05)
    assert found.groups(10.0) == [[0], [1]]
    unsure = replace(found, covariance=found.covariance * 1e6)
    assert unsure.groups(10.0) == [[0, 1]]


@pytest.mark.parametrize("at_most", [0, -1, 2.5, "two"])
def test_a_number_of_heads_that_counts_nothing_is_refused(calibration, at_most):
    with pytest.raises(CalibrationError, match="heads cannot be searched for"):
        calibration.forces(setting().model.solve_unloaded(), at_most=at_most)


@pytest.mark.parametrize(("diameter_mm", "radius_mm"), [(8.0, 30.0), (20.0, 20.0), (20.0, 36.0), (24.0, 30.0)])
def test_the_error_of_another_heads_template_is_in_its_standard_error(calibration, diameter_mm, radius_mm):
    """Exact fields of such heads, against templates that go linearly in the squared radius."""
    head, angle = Indenter(diameter_mm), np.linspace(0, 2 * np.pi, 12, endpoint=False)
    places = radius_mm * np.column_stack([np.cos(angle), np.sin(angle)])
    contrast = 0.1 * HEAD.area_mm2 / head.area_mm2
    rows = setting().rows(places, np.full(12, contrast), head)
    size = head.squared_radius_mm2 / HEAD.squared_radius_mm2
    strength = calibration._filter(head).match_at(rows, places).strength * HEAD.area_mm2 / head.area_mm2
    error = np.abs(strength / (2 * contrast / (2 + contrast)) - 1)
    stated = SizeError(calibration.model, HEAD.radius_mm)(size, places)
    assert (error < 2 * stated).all()
    assert stated.mean() < 5 * error.mean()
    usual = calibration.force(setting().model.solve_unloaded(), place_mm=places[0])
    assert not usual.flags[0] & Flag.OTHER_HEAD


def test_a_head_far_from_the_calibrated_one_is_flagged(calibration):
    here, place = setting(), np.array([[0.0, 0.0]])
    for diameter_mm, flagged in ((13.0, False), (20.0, False), (40.0, True)):
        head = Indenter(diameter_mm)
        contrast = np.array([0.2 * HEAD.area_mm2 / head.area_mm2])
        loads = RoundLoads.from_contrast(place, np.array([head.radius_mm]), contrast)
        frames = here.model.solve_unloaded() + here.model.readings(loads).change[0]
        one = calibration.force(frames, indenter=head)
        (several,) = calibration.forces(frames, indenter=head)
        assert bool(one.flags[0] & Flag.OTHER_HEAD) is flagged
        assert bool(several.loads.flags[0] & Flag.OTHER_HEAD) is flagged


@pytest.mark.parametrize("apart", [1e-3, 1e-7, 1e-11])
def test_variances_of_heads_that_are_nearly_one_keep_the_digits_their_condition_leaves(apart):
    """Against fifty digits; normal equations square the condition number, and their variances were negative."""
    random = np.random.default_rng(17)
    design = random.standard_normal((3, 60))
    design[1] = design[0] + apart * design[1]
    design[2] *= 1e-6  # a place beside strengths: rows have units of their own
    with mp.workdps(50):
        exact = mp.matrix(design.tolist())
        covariance = (exact * exact.T) ** -1
        expected = np.array([float(covariance[k, k]) for k in range(3)])
    root = _inverse_root(design)
    assert (root**2).sum(axis=1) == pytest.approx(expected, rel=200 * np.finfo(float).eps / apart)


def test_heads_on_the_same_place_have_no_covariance():
    with pytest.raises(np.linalg.LinAlgError):
        _inverse_root(np.array([[1.0, 2.0, 0.0], [0.0, 0.0, 0.0]]))
