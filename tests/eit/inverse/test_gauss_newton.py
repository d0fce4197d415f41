import numpy as np
import pytest
from drawn import drawn
from hypothesis import given, strategies as st

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.imaging import ImagingProblem
from cbsr_qa.domain.readings.loads import NINE_LOCATIONS_MM
from cbsr_qa.eit.inverse.dual import dual_matrix
from cbsr_qa.eit.inverse.priors import noser
from cbsr_qa.eit.inverse.problem import imaging_problem, target_signal
from cbsr_qa.eit.inverse.scaling import agreement, changes, scale_doubts, scale_of
from cbsr_qa_plugins.reconstruction.one_step import GaussNewtonNoser


@pytest.fixture(scope="module")
def problem(pin_sensor) -> ImagingProblem:
    return imaging_problem(pin_sensor())


def brightest_centre(problem: ImagingProblem, image: np.ndarray, fraction: float = 0.85) -> np.ndarray:
    """Centre of mass of what survives the percentage mask (here always one patch)."""
    weights = np.where(image >= fraction * image.max(), image, 0) * problem.mesh.areas_mm2
    return weights @ problem.mesh.centroids_mm / weights.sum()


def frame_of(problem: ImagingProblem, readings: np.ndarray) -> np.ndarray:
    frame = np.zeros(problem.used.shape)
    frame[problem.used] = readings
    return frame


@pytest.mark.parametrize("weighted", [False, True])
def test_dual_form_equals_the_textbook_form(pin_sensor, weighted):
    problem = imaging_problem(pin_sensor(), image_size_mm=8.0)
    jacobian, prior = problem.jacobian, noser(problem.jacobian, 0.5)
    variance = np.random.default_rng(8).uniform(0.5, 2.0, len(jacobian)) if weighted else np.ones(len(jacobian))
    weight = 1 / variance
    normal = jacobian.T @ (weight[:, None] * jacobian) + 0.3**2 * np.diag(prior)
    primal = np.linalg.solve(normal, jacobian.T * weight)
    dual = dual_matrix(jacobian, prior, 0.3, variance if weighted else None)
    assert np.abs(dual - primal).max() < 1e-10 * np.abs(primal).max()


def test_nine_places_are_found_at_60_dB(problem):
    """Exponent 0.25 balances centre and rim; the images of 0.5 lean towards the sheet's middle."""
    random = np.random.default_rng(11)
    errors = {}
    for exponent in (0.25, 0.5):
        prepared = GaussNewtonNoser(exponent=exponent).prepare(problem)
        errors[exponent] = []
        for place in NINE_LOCATIONS_MM:
            signal = target_signal(problem, x_mm=place[0], y_mm=place[1], radius_mm=6.5, contrast=0.5)
            noise = 1e-3 * np.abs(problem.reference) * random.standard_normal((8, len(signal)))
            for image in prepared.images(signal + noise):
                errors[exponent].append(np.hypot(*(brightest_centre(problem, image) - place)))
    assert np.mean(errors[0.25]) < 0.6
    assert np.mean(errors[0.5]) < 2.0
    assert np.max(errors[0.5]) < 3.6


def test_no_regularisation_at_all_explains_every_reading(problem):
    """λ = 0 is the image of least norm that explains the readings, to the digits their condition number leaves."""
    matrix = GaussNewtonNoser(hyperparameter=0.0).prepare(problem).matrix
    readings = problem.jacobian @ np.random.default_rng(4).standard_normal(len(problem.mesh.elements))
    assert np.abs(problem.jacobian @ (matrix @ readings) - readings).max() < 1e-9 * np.abs(readings).max()


def test_readings_that_do_not_determine_an_image_need_regularisation(problem):
    twice = np.vstack([problem.jacobian, problem.jacobian[:3]])
    with pytest.raises(NumericsError, match="too small"):
        dual_matrix(twice, noser(twice, 0.5), 0.0)
    assert np.isfinite(dual_matrix(twice, noser(twice, 0.5), 1e-3)).all()


def test_impossible_problems_are_refused(pin_sensor):
    sensor = pin_sensor()
    few = np.zeros(sensor.pattern.shape, dtype=bool)
    few[0, 2:9] = True
    with pytest.raises(NumericsError, match="only 7 independent readings remain with 201 masked"):
        imaging_problem(sensor, used=few)
    with pytest.raises(NumericsError, match="does not match frames"):
        imaging_problem(sensor, used=np.ones((16, 13), dtype=bool))


@given(factor=st.floats(1e-6, 1e6), sign=st.sampled_from([-1, 1]))
@drawn(20)
def test_images_do_not_depend_on_the_unit_of_the_voltages(problem, factor, sign):
    reference = frame_of(problem, problem.reference)
    frames = reference + frame_of(problem, 1e-3 * problem.reference[::-1])[None]
    scale = scale_of(sign * factor * reference, problem)
    assert scale == pytest.approx(sign * factor, rel=1e-12)
    found = changes(sign * factor * frames, sign * factor * reference, problem, scale)
    assert np.allclose(found, changes(frames, reference, problem, 1.0), rtol=1e-6, atol=1e-12)


def test_agreement_tells_polarity_and_order(problem):
    reference = frame_of(problem, problem.reference)
    assert agreement(3 * reference, problem) == pytest.approx(1)
    assert agreement(-reference, problem) == pytest.approx(-1)
    assert agreement(np.roll(reference, 5, axis=1), problem) < 0.7
    assert agreement(0 * reference, problem) == 0


def test_references_that_scale_to_nothing_are_refused(problem):
    with pytest.raises(NumericsError, match="uncorrelated"):
        scale_of(np.zeros(problem.used.shape), problem)
    orthogonal = np.arange(len(problem.reference), dtype=float)
    orthogonal -= problem.reference * (orthogonal @ problem.reference) / (problem.reference @ problem.reference)
    with pytest.raises(NumericsError, match="uncorrelated"):
        scale_of(frame_of(problem, orthogonal), problem)


def test_readings_that_are_no_numbers_are_refused_by_place(problem):
    reference = frame_of(problem, problem.reference)
    frames = np.stack([reference, reference])
    frames[0, 0, 0] = np.nan  # touches a driven electrode: not used, not looked at
    assert np.isfinite(changes(frames, reference, problem, 1.0)).all()
    frames[1, 4, 9] = np.inf
    with pytest.raises(NumericsError, match=r"drive 4, measure 9\) of frame 1"):
        changes(frames, reference, problem, 1.0)
    with pytest.raises(NumericsError, match="do not match frames"):
        changes(reference[None, :, :15], reference, problem, 1.0)


@given(
    unit=st.floats(-9, 9), seed=st.integers(0, 2**32 - 1), offset=st.floats(20, 1e6), sign=st.sampled_from([-1, 1])
)
@drawn(20)
def test_a_reference_on_an_offset_has_a_doubtful_scale(problem, unit, seed, offset, sign):
    frame = np.zeros(problem.used.shape)
    frame[problem.used] = 10**unit * problem.reference
    uneven = frame * np.exp(0.2 * np.random.default_rng(seed).standard_normal(frame.shape))
    assert scale_doubts(uneven, problem) == ()
    (doubt,) = scale_doubts(uneven + sign * offset * np.abs(frame[problem.used]).mean(), problem)
    assert "offset" in doubt
