"""Readings left out, noisy, or measured: what an imaging problem takes, and how much is lost without them."""

import numpy as np
import pytest

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.eit.inverse.problem import find_masked_electrodes, imaging_problem
from cbsr_qa.eit.inverse.uncertainty import masking_effect


@pytest.mark.parametrize("dead", [(), (3,), (3, 4, 9)])
def test_masked_electrodes_are_those_no_reading_is_left_of(sensor, dead):
    assert find_masked_electrodes(sensor.pattern, sensor.pattern.usable() & ~sensor.pattern.touching(dead)) == dead


def test_an_electrode_with_one_reading_left_is_not_masked(sensor):
    used = sensor.pattern.usable() & ~sensor.pattern.touching([5])
    used[5, 9] = True
    assert find_masked_electrodes(sensor.pattern, used) == ()


def test_electrodes_may_be_missing_while_enough_independent_readings_are_left(sensor):
    for dead in ((0, 1, 8, 12), (0, 3, 8, 12, 13), (0, 1, 2, 3, 4, 5)):
        effect = masking_effect(
            imaging_problem(sensor, used=sensor.pattern.usable() & ~sensor.pattern.touching(dead), image_size_mm=6.0)
        )
        assert effect.electrodes == dead
        assert effect.hardly_seen > 0
        assert "of the sheet is hardly seen" in effect.words()
    with pytest.raises(NumericsError, match="only 6 independent readings remain with 196 masked") as refused:
        imaging_problem(
            sensor, used=sensor.pattern.usable() & ~sensor.pattern.touching([0, 2, 5, 8, 10, 13]), image_size_mm=6.0
        )
    assert "repair" in refused.value.remedy


def test_nothing_left_out_has_no_effect(sensor):
    assert masking_effect(imaging_problem(sensor, image_size_mm=6.0)) is None
    weighted = imaging_problem(sensor, noise_variance=np.full(208, 2.0), image_size_mm=6.0)
    assert masking_effect(weighted) is None


def test_the_effect_is_the_ratio_of_cramer_rao_bounds(sensor):
    """At the worst place, with derivatives by finite differences and the inverse of the whole information matrix."""
    problem = imaging_problem(
        sensor, used=sensor.pattern.usable() & ~sensor.pattern.touching([2, 7]), image_size_mm=4.0
    )
    effect = masking_effect(problem)
    worst = np.array([effect.worst_x_mm, effect.worst_y_mm])

    def signal(jacobian, at):
        away = problem.mesh.centroids_mm - at
        return jacobian @ np.exp(-(away**2).sum(axis=1) / (2 * 3.25**2))

    bounds = []
    for jacobian in (problem.jacobian, problem.nominal.jacobian):
        step = 1e-4
        slopes = [
            (signal(jacobian, worst + shift) - signal(jacobian, worst - shift)) / (2 * step)
            for shift in step * np.eye(2)
        ]
        derivatives = np.column_stack([signal(jacobian, worst), *slopes])
        covariance = np.linalg.inv(derivatives.T @ derivatives)
        bounds.append(np.sqrt(covariance[1, 1] + covariance[2, 2]))
    assert effect.worst == pytest.approx(bounds[0] / bounds[1], rel=1e-4)
    assert effect.electrodes == (2, 7)
    assert (effect.left, effect.of) == (int(problem.used.sum()), 208)


def test_the_more_is_left_out_the_less_is_known(sensor):
    steps = [(3,), (3, 10), (3, 10, 6)]
    effects = [
        masking_effect(
            imaging_problem(sensor, used=sensor.pattern.usable() & ~sensor.pattern.touching(d), image_size_mm=6.0)
        )
        for d in steps
    ]
    typical = [1.0, *(effect.typical for effect in effects)]
    assert (np.diff(typical) > 0).all()
    assert all(effect.worst > effect.typical for effect in effects)
    # What is lost is lost where the electrode was.
    here = sensor.electrodes.positions_mm()[3]
    at = np.array([effects[0].worst_x_mm, effects[0].worst_y_mm])
    assert at @ here > 0.9 * np.linalg.norm(at) * np.linalg.norm(here)


def test_the_effect_is_said_in_words(sensor):
    effect = masking_effect(
        imaging_problem(sensor, used=sensor.pattern.usable() & ~sensor.pattern.touching([3, 4, 9]), image_size_mm=6.0)
    )
    assert effect.words().startswith("images are made without electrodes 3, 4 and 9, from ")
    used = sensor.pattern.usable()
    used[0, 5] = False
    single = masking_effect(imaging_problem(sensor, used=used, image_size_mm=6.0))
    assert "without some readings, from 207 of 208 readings" in single.words()
    assert 1 <= single.typical < 1.05


def test_measured_frames_come_whole_or_as_used_readings(sensor):
    used = sensor.pattern.usable() & ~sensor.pattern.touching([3])
    frames = np.random.default_rng(4).standard_normal((3, 16, 16))
    whole = imaging_problem(sensor, used=used, sample=frames, measured=frames[0], image_size_mm=6.0)
    chosen = imaging_problem(sensor, used=used, sample=frames[:, used], measured=frames[0][used], image_size_mm=6.0)
    for problem in (whole, chosen):
        assert np.array_equal(problem.sample, frames[:, used])
        assert np.array_equal(problem.measured, frames[0, used])
        assert problem.nominal is not None
        assert problem.nominal.sample is None


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"sample": np.ones((2, 207))}, "sample of shape"),
        ({"sample": np.ones(208)}, "sample of shape"),
        ({"sample": np.ones((0, 208))}, "sample of shape"),
        ({"sample": np.full((1, 208), np.inf)}, "sample holds a reading that is not a finite number"),
        ({"measured": np.ones((1, 208))}, "measured frame of shape"),
        ({"measured": np.full(208, np.nan)}, "measured frame holds a reading that is not a finite"),
    ],
)
def test_measured_frames_that_are_none_are_refused(sensor, options, reason):
    with pytest.raises(NumericsError, match=reason):
        imaging_problem(sensor, image_size_mm=6.0, **options)
