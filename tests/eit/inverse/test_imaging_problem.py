"""What imaging problems and the scaling of readings are given: refused by name where it makes no image."""

import numpy as np
import pytest

from cbsr_qa.domain.errors import NumericsError, RefusedError
from cbsr_qa.domain.sensor.patterns import DrivePattern, adjacent_pattern, imaging_problems
from cbsr_qa.domain.sensor.sensor_type import Response, SensorType
from cbsr_qa.eit.inverse.problem import _disc_change, imaging_problem, target_signal
from cbsr_qa.eit.inverse.scaling import agreement, changes, scale_of
from cbsr_qa_plugins.reconstruction.one_step import GaussNewtonLaplace


@pytest.fixture(scope="module")
def frame(problem) -> np.ndarray:
    """A frame of the unit model, its other readings zero."""
    whole = np.zeros(problem.used.shape)
    whole[problem.used] = problem.reference
    return whole


def test_a_simulated_target_is_the_same_to_the_last_bit_whatever_was_computed_before(problem):
    target = {"x_mm": 12.0, "y_mm": -20.0, "radius_mm": 6.5, "contrast": 0.3}
    first = target_signal(problem, **target)
    _disc_change.cache_clear()
    for x_mm in (9.0, 14.0, 18.0):  # their rims share nodes with the target's
        target_signal(problem, **(target | {"x_mm": x_mm}))
    np.testing.assert_array_equal(target_signal(problem, **target), first)


def driven_once(sensor: SensorType, measured: int) -> SensorType:
    """One drive pair, and so many of the adjacent pairs measured that touch it not."""
    measure = adjacent_pattern(16).measure
    ends = measure[2 : 2 + measured]
    return SensorType("one", 50.0, 4.0, sensor.electrodes, DrivePattern(16, ((0, 1),), ends), Response.AUTO)


def test_a_pattern_that_a_file_may_have_can_be_imaged(sensor):
    one = driven_once(sensor, 13)
    assert not [what for what in imaging_problems(one.pattern) if "independent" in what]
    small = imaging_problem(one, image_size_mm=6.0)
    assert small.reference.shape == (13,)
    assert np.isfinite(GaussNewtonLaplace().prepare(small).matrix).all()


def test_a_pattern_of_too_few_readings_is_not_blamed_on_a_mask(sensor):
    few = driven_once(sensor, 7)
    assert any("gives 7 independent readings" in what for what in imaging_problems(few.pattern))
    with pytest.raises(NumericsError, match="the pattern gives 7 independent readings; at least 8") as refused:
        imaging_problem(few, image_size_mm=6.0)
    assert "mask" not in str(refused.value)


def test_only_variances_of_used_readings_are_compared(sensor, problem):
    variance = np.ones(sensor.pattern.shape)
    variance[3, 3], variance[3, 9] = 1e-30, 1e11
    weighed = imaging_problem(sensor, noise_variance=variance, image_size_mm=6.0).noise_variance
    assert (1 / weighed).mean() == pytest.approx(1)
    assert weighed.max() / weighed.min() == pytest.approx(1e11)


def odd(value: float) -> np.ndarray:
    variance = np.ones((16, 16))
    variance[3, 9] = value
    return variance


@pytest.mark.parametrize(
    ("variance", "said", "remedy"),
    [
        (odd(1e-15), r"of reading \(drive 3, measure 9\) is 1e-15, that of .* at most", "its channel"),
        (odd(1e15), r"of reading \(drive 3, measure 9\) is 1e\+15, that of .* at most", "its channel"),
        *(
            (np.full(208, unit), r"\(drive 0, measure 2\) is .* beyond the range of numbers", "unit")
            for unit in (1e-310, 1e-309, 1.7e308)
        ),
        (np.zeros((16, 16)), r"variance of reading \(drive 0, measure 2\) is 0\.0 .* positive finite", ""),
        (np.full(208, np.nan), "positive finite", ""),
        (np.ones(207), r"shape \(207,\); there are 208 used", ""),
    ],
)
def test_variances_that_are_none_or_too_far_apart_are_refused_by_their_reading(sensor, variance, said, remedy):
    with pytest.raises(NumericsError, match=said) as refused:
        imaging_problem(sensor, noise_variance=variance, image_size_mm=6.0)
    assert refused.value.remedy
    assert remedy in refused.value.remedy


@pytest.mark.parametrize("unit", [1e-290, 1e290])
def test_the_unit_of_variances_does_not_count(sensor, unit):
    weighed = imaging_problem(sensor, noise_variance=unit * np.arange(1.0, 209.0), image_size_mm=6.0)
    plain = imaging_problem(sensor, noise_variance=np.arange(1.0, 209.0), image_size_mm=6.0)
    assert np.allclose(weighed.noise_variance, plain.noise_variance, rtol=1e-12, atol=0)


@pytest.mark.parametrize("wrong", [np.ones(208) + 1j, np.full(208, "1.0"), ["a"] * 208, [True] * 208])
@pytest.mark.parametrize("what", ["noise_variance", "sample", "measured"])
def test_numbers_of_other_types_are_refused_not_cast(sensor, what, wrong):
    given = [wrong] if what == "sample" else wrong
    with pytest.raises(NumericsError, match="not real numbers") as refused:
        imaging_problem(sensor, image_size_mm=6.0, **{what: given})
    assert refused.value.remedy


def test_readings_of_other_types_are_refused_not_cast(problem, frame):
    for wrong in (frame + 1j, frame.astype(str), np.full(frame.shape, "volts"), frame > 0):
        for call in (
            lambda wrong=wrong: changes(wrong[None], frame, problem, 1.0),
            lambda wrong=wrong: changes(frame[None], wrong, problem, 1.0),
            lambda wrong=wrong: scale_of(wrong, problem),
            lambda wrong=wrong: agreement(wrong, problem),
        ):
            with pytest.raises(RefusedError, match=r"voltages are of type .* not real numbers"):
                call()


def test_lists_of_readings_are_taken_and_ragged_ones_refused(problem, frame):
    assert scale_of((3.0 * frame).tolist(), problem) == pytest.approx(3)
    assert agreement(frame.tolist(), problem) == pytest.approx(1)
    assert not changes([frame.tolist()], frame.tolist(), problem, 2.0).any()
    with pytest.raises(NumericsError, match="different lengths"):
        scale_of([[1.0, 2.0], [1.0]], problem)
    with pytest.raises(NumericsError, match="reference of shape"):
        scale_of(frame[None], problem)


def test_a_scale_that_leaves_no_numbers_is_refused(problem, frame):
    with pytest.raises(
        NumericsError, match=r"change of reading \(drive \d+, measure \d+\) of frame 1 over"
    ) as refused:
        changes(np.stack([frame, 2 * frame]), frame, problem, 1e-320)
    assert "scale_of" in refused.value.remedy
    for wrong in (0.0, np.nan, np.inf):
        with pytest.raises(NumericsError, match="scale of the sensor is"):
            changes(frame[None], frame, problem, wrong)
    for wrong in (1j, "1"):
        with pytest.raises(NumericsError, match="not real numbers"):
            changes(frame[None], frame, problem, wrong)
