"""Priors in the dual form against the textbook form, null space included."""

import numpy as np
import pytest
from disc_meshes import square_mesh
from scipy.special import gamma, kv
from tiers import rest_but

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.eit.inverse.dual import dual_matrix, dual_spectrum
from cbsr_qa.eit.inverse.noise_figures import noise_figure, noise_figure_of
from cbsr_qa.eit.inverse.priors import Prior, high_pass, indenter_smoothness, laplace, laplace_matrix
from cbsr_qa.eit.inverse.problem import target_signal

_WIDTH_MM = 11.0


def filter_of(mesh: Mesh, width_mm: float) -> np.ndarray:
    """Adler & Guardo's high-pass filter, element by element."""
    rows = []
    for place in mesh.centroids_mm:
        away = np.hypot(*(mesh.centroids_mm - place).T)
        weights = mesh.areas_mm2 * 0.5 ** ((2 * away / width_mm) ** 2)
        rows.append(-weights / weights.sum())
    return np.eye(len(rows)) + np.array(rows)


SMOOTH = {
    "laplace": (laplace, lambda mesh: laplace_matrix(mesh).toarray()),
    "high-pass": (
        lambda mesh: high_pass(mesh, _WIDTH_MM),
        lambda mesh: filter_of(mesh, _WIDTH_MM).T @ filter_of(mesh, _WIDTH_MM),
    ),
}


@pytest.mark.parametrize("name", SMOOTH)
@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize("hyperparameter", rest_but({30.0}, [1e-3, 1e-2, 1.0, 30.0]))
def test_priors_that_leave_a_constant_free_give_the_textbook_image(problem, name, weighted, hyperparameter):
    """(JᵀWJ + λ²R) is regular although R is not: the readings see the constant."""
    made, written_out = SMOOTH[name]
    jacobian, penalty = problem.jacobian, written_out(problem.mesh)
    variance = np.random.default_rng(3).uniform(0.2, 4.0, len(jacobian)) if weighted else np.ones(len(jacobian))
    normal = jacobian.T @ (jacobian / variance[:, None]) + hyperparameter**2 * penalty
    primal = np.linalg.solve(normal, jacobian.T / variance)
    dual = dual_matrix(jacobian, made(problem.mesh), hyperparameter, variance if weighted else None)
    spectrum = dual_spectrum(jacobian, made(problem.mesh), variance if weighted else None)
    assert np.abs(dual - primal).max() < 1e-7 * np.abs(primal).max()
    assert np.abs(spectrum.matrix(hyperparameter) - dual).max() < 1e-7 * np.abs(dual).max()


@pytest.mark.parametrize("name", SMOOTH)
def test_a_change_of_the_whole_sheet_is_read_exactly_however_much_is_smoothed(problem, name):
    prior = SMOOTH[name][0](problem.mesh)
    whole = np.full(len(problem.mesh.elements), 0.07)
    readings = problem.jacobian @ whole
    for hyperparameter in (1e-2, 1.0, 1e4):
        image = dual_matrix(problem.jacobian, prior, hyperparameter) @ readings
        assert np.abs(image - whole).max() < 1e-8


@pytest.mark.parametrize("name", SMOOTH)
def test_noise_figure_of_a_spectrum_counts_what_is_free(problem, name):
    prior, areas = SMOOTH[name][0](problem.mesh), problem.mesh.areas_mm2
    signal = target_signal(problem, x_mm=0, y_mm=0, radius_mm=6.5, contrast=0.01)
    variance = np.random.default_rng(6).uniform(0.5, 2.0, len(signal))
    figure = noise_figure_of(dual_spectrum(problem.jacobian, prior, variance), signal, areas, variance)
    for hyperparameter in (1e-3, 1e-2, 1.0):
        matrix = dual_matrix(problem.jacobian, prior, hyperparameter, variance)
        expected = noise_figure(matrix, signal, areas, noise_variance=variance)
        assert figure(hyperparameter) == pytest.approx(expected, rel=1e-8)


def test_what_the_readings_do_not_see_may_not_be_left_free(problem):
    unseen = np.linalg.svd(problem.jacobian)[2][-1:].T
    prior = Prior(lambda columns: columns.copy(), unseen)
    with pytest.raises(NumericsError, match="that the prior leaves free"):
        dual_matrix(problem.jacobian, prior, 1.0)


def test_indenter_covariance_is_matern(problem):
    """Against the general formula with a modified Bessel function, smoothness 3/2."""
    count, length_mm = len(problem.mesh.elements), 6.5
    covariance = indenter_smoothness(problem.mesh, length_mm).covariance(np.eye(count))
    away = np.hypot(*(problem.mesh.centroids_mm[:, None] - problem.mesh.centroids_mm[None]).transpose(2, 0, 1))
    scaled = np.sqrt(3) * np.maximum(away, 1e-9) / length_mm
    expected = 2 ** (1 - 1.5) / gamma(1.5) * scaled**1.5 * kv(1.5, scaled)
    assert np.abs(covariance - expected).max() < 1e-7
    assert np.linalg.eigvalsh(covariance).min() > 0


def test_lengths_must_be_lengths(problem):
    for wrong in (0.0, -1.0, float("nan"), float("inf")):
        for prior in (high_pass, indenter_smoothness):
            with pytest.raises(NumericsError, match="positive finite"):
                prior(problem.mesh, wrong)


def test_a_filter_too_large_to_hold_is_refused():
    with pytest.raises(NumericsError, match="10658 elements; at most 10000"):
        high_pass(square_mesh(73, size_mm=73.0), 5.0)
