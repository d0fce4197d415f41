import numpy as np
import pytest

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.eit.inverse.dual import DualSpectrum, dual_matrix, dual_spectrum
from cbsr_qa.eit.inverse.noise_figures import NoiseFigureForm, hyperparameter_for, noise_figure, noise_figure_of
from cbsr_qa.eit.inverse.priors import noser
from cbsr_qa.eit.inverse.problem import target_signal


@pytest.fixture(scope="module")
def signal(problem) -> np.ndarray:
    return target_signal(problem, x_mm=0, y_mm=0, radius_mm=6.5, contrast=0.01)


@pytest.fixture(scope="module")
def prior(problem) -> np.ndarray:
    return noser(problem.jacobian, 0.5)


@pytest.fixture(scope="module")
def spectrum(problem, prior) -> DualSpectrum:
    return dual_spectrum(problem.jacobian, prior)


def test_propagated_noise_is_what_samples_show(problem, prior, signal):
    variance = np.random.default_rng(1).uniform(0.2, 3.0, len(signal)) * 1e-8
    matrix = dual_matrix(problem.jacobian, prior, 0.1, variance / variance.mean())
    areas = problem.mesh.areas_mm2
    noise = np.random.default_rng(2).standard_normal((4000, len(signal))) * np.sqrt(variance)
    image_noise = np.sqrt((((noise @ matrix.T) * areas) ** 2).mean())
    image_signal = np.abs(areas * (matrix @ signal)).mean()
    sampled = np.abs(signal).mean() / np.sqrt(variance.mean()) / (image_signal / image_noise)
    assert noise_figure(matrix, signal, areas, noise_variance=variance) == pytest.approx(sampled, rel=0.02)


def test_does_not_depend_on_units(problem, prior, signal):
    matrix = dual_matrix(problem.jacobian, prior, 0.1)
    areas = problem.mesh.areas_mm2
    plain = noise_figure(matrix, signal, areas)
    assert noise_figure(1e3 * matrix, 1e-6 * signal, 1e-6 * areas) == pytest.approx(plain, rel=1e-12)
    assert noise_figure(matrix, signal, areas, noise_variance=np.full(len(signal), 7.0)) == pytest.approx(plain)


@pytest.mark.parametrize("target", [0.7, 1.0, 2.0])
@pytest.mark.parametrize("weighted", [False, True])
def test_chosen_hyperparameter_has_the_target(problem, prior, signal, target, weighted):
    variance = np.random.default_rng(4).uniform(0.3, 2.0, len(signal)) if weighted else None
    areas = problem.mesh.areas_mm2
    spectrum = dual_spectrum(problem.jacobian, prior, variance)
    chosen = hyperparameter_for(target, spectrum, signal, areas, variance)
    matrix = dual_matrix(problem.jacobian, prior, chosen, variance)
    assert np.allclose(spectrum.matrix(chosen), matrix, rtol=0, atol=1e-9 * np.abs(matrix).max())
    assert noise_figure(matrix, signal, areas, noise_variance=variance) == pytest.approx(target, rel=1e-8)


def test_unreachable_targets_are_refused_with_the_range(problem, spectrum, signal):
    areas = problem.mesh.areas_mm2
    for target in (1e-3, 1e9, float("nan")):
        with pytest.raises(NumericsError, match=r"cannot be reached; this sensor type allows 0\.\d+ to"):
            hyperparameter_for(target, spectrum, signal, areas)


def test_falls_as_the_image_is_smoothed(problem, spectrum, signal):
    figure = noise_figure_of(spectrum, signal, problem.mesh.areas_mm2)
    unit = np.sqrt(spectrum.values[-1])
    figures = [figure(value * unit) for value in np.geomspace(1e-3, 1, 12)]
    assert (np.diff(figures) < 0).all()


def test_a_matrix_that_sees_nothing_has_no_noise_figure(problem, signal):
    nothing = np.zeros((len(problem.mesh.elements), len(signal)))
    with pytest.raises(NumericsError, match="does not respond to the target"):
        noise_figure(nothing, signal, problem.mesh.areas_mm2)
    with pytest.raises(NumericsError, match="assumes equal noise"):
        noise_figure(
            nothing + 1, signal, problem.mesh.areas_mm2, noise_variance=signal**2, form=NoiseFigureForm.EIDORS
        )
