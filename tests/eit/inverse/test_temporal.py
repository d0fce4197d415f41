import numpy as np
import pytest
from drawn import drawn
from hypothesis import given, strategies as st

from cbsr_qa.domain.errors import ConfigError, NumericsError
from cbsr_qa.eit.inverse.noise_figures import central_signal
from cbsr_qa.eit.inverse.priors import indenter_smoothness
from cbsr_qa.eit.inverse.problem import imaging_problem
from cbsr_qa.eit.inverse.temporal import Correlation, smooth
from cbsr_qa_plugins.reconstruction.one_step import GaussNewtonIndenter, Temporal

_LAMBDA = 0.03


@pytest.fixture(scope="module")
def frames(problem) -> np.ndarray:
    """A target that comes, stays and goes, in noise."""
    present = np.array([0, 0, 0.5, 1, 1, 1, 1, 0.2, 0, 0])[:, None]
    noise = 1e-3 * np.abs(problem.reference) * np.random.default_rng(6).standard_normal((10, 208))
    return present * central_signal(problem, 0.2) + noise


def temporal(problem, **options):
    return Temporal(hyperparameter=_LAMBDA, **options).prepare(problem)


def close(one, other, tolerance=1e-10):
    return np.abs(one - other).max() < tolerance * np.abs(other).max()


@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize("time", [0.7, 5.0])
def test_a_block_is_the_textbook_block(problem, frames, time, weighted):
    """(Γ⊗P)J̃ᵀ(J̃(Γ⊗P)J̃ᵀ + λ²W⁻¹)⁻¹ỹ as Adler, Dai & Lionheart 2007 write it, with one large matrix."""
    variance = np.random.default_rng(3).uniform(0.5, 2.0, (16, 16)) if weighted else None
    problem = imaging_problem(problem.sensor_type, image_size_mm=6.0, noise_variance=variance)
    block, jacobian = frames[:4], problem.jacobian
    apart = np.abs(np.subtract.outer(np.arange(4), np.arange(4)))
    together = np.exp(-apart / time)
    seen = indenter_smoothness(problem.mesh, 6.5).covariance(jacobian.T).T
    noise = np.ones(208) if variance is None else problem.noise_variance
    system = np.kron(together, seen @ jacobian.T) + _LAMBDA**2 * np.diag(np.tile(noise, 4))
    weights = np.linalg.solve(system, block.ravel()).reshape(4, 208)
    expected = together @ weights @ seen
    assert close(temporal(problem, correlation_frames=time).images(block), expected, 1e-8)


def test_frames_that_know_nothing_of_each_other_are_imaged_one_by_one(problem, frames):
    alone = GaussNewtonIndenter(hyperparameter=_LAMBDA).prepare(problem).images(frames)
    assert close(temporal(problem, correlation_frames=0.0).images(frames), alone)
    one_by_one = np.vstack([temporal(problem).images(frame[None]) for frame in frames])
    assert close(one_by_one, alone)


def test_one_lasting_image_is_that_of_the_mean_with_the_means_noise(problem, frames):
    mean = GaussNewtonIndenter(hyperparameter=_LAMBDA / np.sqrt(10)).prepare(problem)
    expected = mean.images(frames.mean(axis=0)[None])
    images = temporal(problem, correlation_frames=float("inf")).images(frames)
    assert close(images, np.repeat(expected, 10, axis=0), 1e-9)
    last = temporal(problem, correlation_frames=float("inf"), lag=0).images(frames)[-1]
    assert close(last, expected[0], 1e-9)


@given(lag=st.integers(0, 12), time=st.floats(0.3, 30))
@drawn(15)
def test_with_a_lag_an_image_knows_what_a_block_that_ends_there_knows(lag, time):
    random = np.random.default_rng(1)
    readings, values = random.standard_normal((9, 5)), np.array([0.0, 1e-3, 0.1, 1.0, 50.0])
    found = smooth(readings, values, 0.3, Correlation(time, lag))
    for frame in range(9):
        until = smooth(readings[: frame + lag + 1], values, 0.3, Correlation(time))
        assert np.allclose(found[frame], until[frame], rtol=1e-9, atol=1e-12)


def test_time_has_no_direction_for_the_smoother(problem, frames):
    prepared = temporal(problem)
    assert close(prepared.images(frames[::-1]), prepared.images(frames)[::-1])


def test_noise_falls_with_the_correlation_time(problem):
    """The stated figures are those of Monte Carlo, for a change that lasts."""
    random, signal = np.random.default_rng(5), central_signal(problem)
    deviation, areas = 1e-6, problem.mesh.areas_mm2
    figures = []
    for time in (0.0, 2.0, 8.0):
        prepared = Temporal(correlation_frames=time).prepare(problem)
        block = signal + deviation * random.standard_normal((1200, 208))
        images = areas * prepared.images(block)[100:-100]
        clean = areas * prepared.images(np.tile(signal, (400, 1)))[200]
        snr = np.abs(clean).mean() / np.sqrt((images - clean).var(axis=0).mean())
        stated = float(prepared.choice.how.rsplit(" ", 1)[1])
        assert stated == pytest.approx(np.abs(signal).mean() / deviation / snr, abs=0.03)
        figures.append(stated)
    assert figures[0] == pytest.approx(1.0, abs=0.01)
    assert figures[0] > figures[1] > figures[2]


def test_a_live_image_does_not_know_the_future(problem, frames):
    prepared = temporal(problem, lag=1)
    changed = frames.copy()
    changed[6:] *= -3
    assert np.array_equal(prepared.images(frames)[:5], prepared.images(changed)[:5])
    assert not np.array_equal(prepared.images(frames)[5], prepared.images(changed)[5])


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"correlation_frames": -1.0}, "correlation_frames is -1.0"),
        ({"correlation_frames": float("nan")}, "correlation_frames is nan"),
        ({"lag": -1}, "lag is -1"),
        ({"hyperparameter": -1.0}, "hyperparameter is -1.0"),
        ({"hyperparameter": 0.0}, "too small"),
    ],
)
def test_impossible_options_are_refused(problem, options, reason):
    with pytest.raises((ConfigError, NumericsError), match=reason):
        Temporal(**options).prepare(problem)
