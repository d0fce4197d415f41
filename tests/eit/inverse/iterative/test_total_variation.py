import re
from dataclasses import replace

import numpy as np
import pytest
from drawn import drawn
from hypothesis import given, strategies as st

from cbsr_qa.domain.errors import ConfigError, NumericsError
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.eit.inverse.iterative.total_variation import TotalVariation as Minimise, jump_matrix
from cbsr_qa.eit.inverse.iterative.total_variation_images import TotalVariationImages, WhiteReadings, choose_alpha
from cbsr_qa.eit.inverse.noise_figures import central_signal
from cbsr_qa.eit.inverse.problem import imaging_problem
from cbsr_qa_plugins.reconstruction.iterative import TotalVariation
from cbsr_qa_plugins.reconstruction.one_step import GaussNewtonNoser

_ALPHA = 2.6e-8


@pytest.fixture(scope="module")
def noisy(problem) -> np.ndarray:
    noise = 1e-3 * np.abs(problem.reference).mean() * np.random.default_rng(2).standard_normal(208)
    return central_signal(problem, 0.2) + noise


@pytest.fixture(scope="module")
def prepared(problem):
    """Prepared with a parameter that is given."""
    return TotalVariation(hyperparameter=_ALPHA).prepare(problem)


@pytest.fixture(scope="module")
def image(prepared, noisy) -> np.ndarray:
    """The image of the parameter that is given."""
    return prepared.images(noisy[None])


def strip(count: int, edge_mm: float) -> Mesh:
    """Triangles in a row, each joined to the next by an edge of this length."""
    height = np.sqrt(edge_mm**2 - 0.25)
    nodes = np.column_stack([np.arange(count + 2) / 2, height * (np.arange(count + 2) % 2)])
    corners = np.arange(count)[:, None] + np.arange(3)
    corners[::2] = corners[::2, ::-1]
    return Mesh(nodes, corners)


def objective(mesh: Mesh, rows: np.ndarray, readings: np.ndarray, alpha: float, image: np.ndarray) -> float:
    return 0.5 * float(((rows @ image - readings) ** 2).sum()) + alpha * float(
        np.abs(jump_matrix(mesh) @ image).sum()
    )


def test_jumps_are_weighed_by_the_length_of_the_edge():
    mesh = strip(6, 2.5)
    jumps = jump_matrix(mesh)
    assert jumps.shape == (5, 6)
    assert np.abs(jumps @ np.array([0.0, 0, 3, 3, 1, 1])) == pytest.approx([0, 7.5, 0, 5, 0])


def test_a_step_is_denoised_as_it_can_be_by_hand():
    """With A = I each plateau of a chain moves by α l over its length (taut string)."""
    mesh, alpha, edge = strip(12, 1.7), 0.2, 1.7
    step = np.where(np.arange(12) < 5, 1.0, 4.0)
    found = Minimise(mesh, np.eye(12), tolerance=1e-12).image(step, alpha)
    expected = step + np.where(np.arange(12) < 5, alpha * edge / 5, -alpha * edge / 7)
    assert np.abs(found.image - expected).max() < 1e-5
    assert found.residual == pytest.approx((alpha * edge) ** 2 * (1 / 5 + 1 / 7), rel=1e-5)


def test_a_bump_too_weak_for_its_edges_is_levelled():
    """Its two edges cost 2 α l; a bump of height h on one element is gone where h ≤ 2 α l (1 + 1/rest) or so."""
    mesh, edge = strip(9, 2.0), 2.0
    bump = np.where(np.arange(9) == 4, 1.0, 0.0)
    gone, left = (Minimise(mesh, np.eye(9), tolerance=1e-12).image(bump, alpha).image for alpha in (0.26, 0.1))
    assert np.abs(gone - 1 / 9).max() < 1e-5
    assert left[4] == pytest.approx(1 - 2 * 0.1 * edge, abs=1e-6)


def test_nothing_near_the_minimiser_is_better(problem, noisy):
    white = WhiteReadings.from_problem(problem)
    readings = white.white(noisy[None])[0]
    found = Minimise(problem.mesh, white.rows, tolerance=1e-7).image(readings, _ALPHA)
    best = objective(problem.mesh, white.rows, readings, _ALPHA, found.image)
    random = np.random.default_rng(4)
    for size in np.geomspace(1e-6, 1e-1, 12):
        blocks = np.hypot(*(problem.mesh.centroids_mm - random.uniform(-40, 40, 2)).T) < random.uniform(4, 30)
        for direction in (random.standard_normal(len(found.image)), blocks - 0.0, found.image, np.ones(len(blocks))):
            for sign in (1, -1):
                moved = found.image + sign * size * direction
                assert objective(problem.mesh, white.rows, readings, _ALPHA, moved) >= best * (1 - 1e-7)


def test_a_smooth_image_with_the_same_residual_has_more_total_variation(problem, noisy):
    white = WhiteReadings.from_problem(problem)
    found = TotalVariation(hyperparameter=_ALPHA).prepare(problem).minimisers(noisy[None])[0]
    jumps = jump_matrix(problem.mesh)
    for value in (0.002, 0.01, 0.03):
        smooth = GaussNewtonNoser(hyperparameter=value).prepare(problem).images(noisy[None])[0]
        if ((white.rows @ smooth - white.white(noisy[None])[0]) ** 2).sum() <= found.residual:
            assert np.abs(jumps @ smooth).sum() > 1.2 * np.abs(jumps @ found.image).sum()
            break
    else:
        pytest.fail("no smooth image explains the readings as well")


@given(factor=st.floats(1e-3, 1e3), sign=st.sampled_from([-1, 1]))
@drawn(6)
def test_readings_and_parameter_scale_together(problem, noisy, factor, sign):
    white = WhiteReadings.from_problem(problem)
    minimise = Minimise(problem.mesh, white.rows, tolerance=1e-7)
    one = minimise.image(white.white(noisy[None])[0], _ALPHA).image
    other = minimise.image(sign * factor * white.white(noisy[None])[0], factor * _ALPHA).image
    assert np.abs(other - sign * factor * one).max() < 1e-6 * factor * np.abs(one).max()


def test_from_some_parameter_on_the_image_is_flat(problem, noisy):
    white = WhiteReadings.from_problem(problem)
    readings, minimise = white.white(noisy[None])[0], Minimise(problem.mesh, white.rows, tolerance=1e-7)
    flat = minimise.flattening(readings)
    ones = white.rows.sum(axis=1)
    for factor in (1.0, 10.0, 1e9):
        image = minimise.image(readings, factor * flat).image
        assert np.allclose(image, ones @ readings / (ones @ ones), rtol=1e-12)
    assert np.ptp(minimise.image(readings, 0.1 * flat).image) > 0


@pytest.mark.rest
def test_the_parameter_means_the_same_on_every_mesh(problem, noisy):
    residuals = []
    for size in (7.0, 5.0, 4.0):
        finer = imaging_problem(problem.sensor_type, image_size_mm=size)
        residuals.append(TotalVariation(hyperparameter=_ALPHA).prepare(finer).minimisers(noisy[None])[0].residual)
    assert max(residuals) < 1.06 * min(residuals)


@pytest.mark.rest
def test_the_chosen_parameter_leaves_a_residual_of_the_noises_size(problem, noisy):
    prepared = TotalVariation().prepare(problem)
    variance = (1e-3 * np.abs(problem.reference).mean()) ** 2
    residual = prepared.minimisers(noisy[None])[0].residual / 104  # of other noise than it was chosen on
    assert residual == pytest.approx(variance, rel=0.35)
    assert "60 dB below the mean reading" in prepared.choice.how
    assert 0.1 < prepared.choice.noise_figure < 2
    louder = TotalVariation(noise_dB=40.0).prepare(problem)
    assert louder.choice.value == pytest.approx(10 * prepared.choice.value, rel=1e-5)
    assert louder.variance == pytest.approx(100 * variance)
    assert louder.choice.noise_figure == pytest.approx(prepared.choice.noise_figure, rel=1e-3)


@pytest.mark.rest
def test_measured_changes_choose_for_themselves(problem, noisy):
    noise = 1e-3 * np.abs(problem.reference).mean() * np.random.default_rng(9).standard_normal((3, 208))
    sample = central_signal(problem, 0.2) + noise
    choice, _ = choose_alpha(replace(problem, sample=sample), given=None, noise_dB=60.0)
    assert "3 measured changes" in choice.how
    assert choice.value == pytest.approx(_ALPHA, rel=0.5)
    with pytest.raises(NumericsError, match="only noise"):
        choose_alpha(replace(problem, sample=noise), given=None, noise_dB=60.0)


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"hyperparameter": 0.0}, "hyperparameter is 0.0"),
        ({"hyperparameter": -1.0}, "hyperparameter is -1.0"),
        ({"tolerance": 1e-9}, "tolerance is 1e-09"),
        ({"iterations": 0}, "from 1 to 1000"),
        ({"noise_dB": float("inf")}, "noise_dB is inf"),
        ({"noise_dB": -60.0}, "noise_dB is -60"),
        ({"iterations": 1001}, "iterations is 1001"),
    ],
)
def test_impossible_options_are_refused(options, reason):
    with pytest.raises(ConfigError, match=reason) as refused:
        TotalVariation(**options)
    assert refused.value.remedy


@pytest.mark.parametrize("options", [{"hyperparameter": _ALPHA, "iterations": 3}, {"hyperparameter": 1e-18}])
def test_an_image_that_did_not_converge_is_refused(problem, prepared, noisy, options):
    hard = replace(
        prepared,
        choice=replace(prepared.choice, value=options["hyperparameter"]),
        minimise=Minimise(problem.mesh, prepared.readings.rows, most_steps=options.get("iterations", 60)),
    )
    with pytest.raises(NumericsError, match=r"did not converge: after \d+ of \d+ steps") as refused:
        hard.images(noisy[None])
    assert "raise the hyperparameter" in refused.value.remedy


@pytest.mark.rest
def test_a_frame_no_image_explains_is_refused(problem, noisy):
    prepared = TotalVariation().prepare(problem)
    prepared.images(noisy[None])
    other = np.roll(noisy, 31)  # readings of no place
    with pytest.raises(NumericsError, match=r"no image explains frame 1: the residual is \d+ times the") as refused:
        prepared.images(np.stack([noisy, 20 * other]))
    assert "noise_dB" in refused.value.remedy
    TotalVariation(hyperparameter=prepared.choice.value).prepare(problem).images(20 * other[None])  # nobody said


@pytest.mark.parametrize(
    ("sample", "reason"),
    [
        (np.zeros((3, 208)), "the same as their reference"),
        pytest.param(np.full((3, 208), 1e-300), "at most 1e-300: the same as", marks=pytest.mark.rest),
        pytest.param(
            np.full((3, 208), 1e300),
            r"a change to choose λ from is 1e\+300 and readings are 1?\d",
            marks=pytest.mark.rest,
        ),
        (np.ones((3, 208)), "identical to the last digit"),
    ],
    ids=["zero", "tiny", "huge", "constant"],
)
def test_a_sample_that_says_nothing_is_refused_as_such(problem, noisy, image, sample, reason):
    with pytest.raises(NumericsError, match=reason) as refused:
        TotalVariation().prepare(replace(problem, sample=sample))
    assert refused.value.remedy
    given = TotalVariation(hyperparameter=_ALPHA).prepare(replace(problem, sample=sample))  # does not look at it
    assert np.array_equal(given.images(noisy[None]), image)


@pytest.mark.parametrize(
    "variance",
    [np.where(np.arange(208) % 2, 1e-300, 1e300), np.full(208, 1e-310), np.full(208, 1e-320)],
    ids=["alternating", "small", "denormal"],
)
def test_extreme_noise_variances_make_no_image_of_no_numbers(problem, prepared, noisy, variance):
    chosen = prepared.choice
    options = {"tolerance": 1e-5, "most_steps": 60}
    with np.errstate(all="ignore"), pytest.raises(NumericsError, match="total variation") as refused:
        TotalVariationImages.from_problem(
            "total-variation", replace(problem, noise_variance=variance), chosen, **options
        ).images(noisy[None])
    assert refused.value.remedy


def test_readings_whose_squares_are_no_numbers_are_refused(prepared, noisy):
    with pytest.raises(NumericsError, match="squares overflow"):
        prepared.images(1e300 * noisy[None])


@pytest.mark.parametrize("alpha", [1e-300, 1e-30, 1e-15])
def test_what_is_said_not_to_have_converged_did_not(problem, noisy, alpha):
    """A gap of zero is no reason: it is that of an image whose dual does not balance it."""
    white = WhiteReadings.from_problem(problem)
    with pytest.raises(NumericsError) as refused:
        Minimise(problem.mesh, white.rows).image(white.white(noisy[None])[0], alpha)
    said = re.search(r"(balance by|gap is) (\S+?)[, ].* (\S+) is needed", refused.value.reason)
    assert said is None or float(said[2]) > float(said[3])
    assert said or "has non-finite values" in refused.value.reason


def test_the_steps_that_are_allowed_are_taken(problem, noisy):
    white = WhiteReadings.from_problem(problem)
    readings = white.white(noisy[None])[0]
    steps = Minimise(problem.mesh, white.rows).image(readings, _ALPHA).steps
    assert Minimise(problem.mesh, white.rows, most_steps=steps).image(readings, _ALPHA).steps == steps
    with pytest.raises(NumericsError, match=f"after {steps - 1} of {steps - 1} steps"):
        Minimise(problem.mesh, white.rows, most_steps=steps - 1).image(readings, _ALPHA)
