"""The linear reconstruction plugins: how their parameter is chosen, and what they refuse."""

import re
from dataclasses import replace

import numpy as np
import pytest
from tiers import rest_but

from cbsr_qa.domain.errors import ConfigError, NumericsError
from cbsr_qa.domain.imaging import ImagingProblem
from cbsr_qa.eit.inverse.noise_figures import central_signal, evidence_of
from cbsr_qa.eit.inverse.problem import imaging_problem, target_signal
from cbsr_qa.eit.inverse.readings import ReadingFold
from cbsr_qa.eit.inverse.truncation import Truncation
from cbsr_qa_plugins.reconstruction.direct import Greit, LinearBackProjection, TruncatedSvd
from cbsr_qa_plugins.reconstruction.one_step import (
    GaussNewtonHighPass,
    GaussNewtonIndenter,
    GaussNewtonLaplace,
    GaussNewtonNoser,
    GaussNewtonTikhonov,
    Temporal,
)

RIDGES = (GaussNewtonNoser, GaussNewtonTikhonov, GaussNewtonLaplace, GaussNewtonHighPass, GaussNewtonIndenter)
CRITERIA = ("noise-figure", "gcv", "l-curve", "discrepancy")


@pytest.fixture(scope="module")
def problem(pin_sensor) -> ImagingProblem:
    return imaging_problem(pin_sensor(), image_size_mm=5.0)


@pytest.fixture(scope="module")
def measured(problem) -> ImagingProblem:
    """With changes measured off centre, at 60 dB of the mean reading."""
    signal = target_signal(problem, x_mm=12, y_mm=-9, radius_mm=6.5, contrast=0.3)
    noise = np.random.default_rng(3).standard_normal((6, len(signal)))
    return replace(problem, sample=signal + deviation_of(problem) * noise)


def deviation_of(problem: ImagingProblem) -> float:
    return 1e-3 * float(np.abs(problem.reference).mean())


@pytest.mark.parametrize("method", rest_but({GaussNewtonNoser, TruncatedSvd}, [*RIDGES, TruncatedSvd]))
@pytest.mark.parametrize("criterion", CRITERIA)
def test_every_criterion_settles_every_method(problem, criterion, method):
    """By itself on simulated frames that are stated with their seed; choices are repeatable, and all are listed."""
    prepared = method(choose=criterion).prepare(problem)
    choice = prepared.choice
    assert choice.curve is not None
    answers = {answer.criterion: answer for answer in choice.curve.answers}
    assert tuple(answers) == CRITERIA
    assert (answers[criterion].value, answers[criterion].words) == (choice.value, choice.how)
    said = "central target of 13 mm and 1% contrast" if criterion == "noise-figure" else "simulated frames (seed"
    assert said in choice.how
    assert 0.2 < choice.noise_figure < 5
    assert np.array_equal(method(choose=criterion).prepare(problem).matrix, prepared.matrix)


@pytest.mark.parametrize("method", [*RIDGES, TruncatedSvd])
def test_the_curve_holds_the_noise_figure_of_every_parameter(problem, method):
    curve = method().prepare(problem).choice.curve
    assert (np.diff(curve.values) > 0).all()
    wanted = np.searchsorted(curve.values, curve.answers[0].value * np.array([0.3, 1.0, 10.0]))
    for at in wanted.clip(max=len(curve.values) - 1):
        value = curve.values[at]
        given = {"components": int(value)} if curve.discrete else {"hyperparameter": float(value)}
        again = method(**given).prepare(problem).choice
        assert again.noise_figure == pytest.approx(curve.noise_figures[at], rel=1e-6)
        assert again.curve is None


def test_measured_changes_are_looked_at_where_there_are_any(problem, measured):
    simulated, found = (GaussNewtonLaplace(choose="gcv").prepare(each).choice for each in (problem, measured))
    assert "6 measured changes" in found.how
    assert found.value != simulated.value
    # A noise figure looks at the model alone.
    assert GaussNewtonLaplace().prepare(measured).choice == GaussNewtonLaplace().prepare(problem).choice


def test_noise_of_measured_changes_is_told_by_their_reciprocal_readings(problem, measured):
    evidence = evidence_of(measured)
    assert evidence.variance == pytest.approx(deviation_of(problem) ** 2, rel=0.2)
    prepared = GaussNewtonIndenter(choose="discrepancy").prepare(measured)
    fold = ReadingFold.from_problem(measured)
    left = fold.fold(measured.sample - prepared.images(measured.sample) @ measured.jacobian.T)
    assert (left**2 / fold.variance).sum() == pytest.approx(evidence.variance * 6 * 104, rel=1e-6)


def test_a_sample_is_looked_at_with_its_own_readings_and_noise(pin_sensor):
    """λ of a sensor with a bad channel is its type's where the type decides, and its own where its data do."""
    sensor = pin_sensor()
    used = sensor.pattern.usable()
    used[4] = False
    masked = imaging_problem(sensor, used=used, image_size_mm=5.0)
    nominal = imaging_problem(sensor, image_size_mm=5.0)
    for criterion in CRITERIA:
        own, of_type = (GaussNewtonLaplace(choose=criterion).prepare(each) for each in (masked, nominal))
        assert own.choice.value == of_type.choice.value
    sampled = replace(masked, sample=evidence_of(masked).changes)
    assert GaussNewtonLaplace(choose="gcv").prepare(sampled).choice.value != of_type.choice.value


def test_without_repeated_readings_the_noise_is_unknown(pin_sensor):
    sensor = pin_sensor()
    once = np.triu(sensor.pattern.usable())
    plain = imaging_problem(sensor, used=once, image_size_mm=5.0)
    sampled = replace(plain, sample=evidence_of(plain).changes)
    with pytest.raises(NumericsError, match="no reading is repeated"):
        GaussNewtonLaplace(choose="discrepancy").prepare(sampled)
    choice = GaussNewtonLaplace(choose="gcv").prepare(sampled).choice
    assert next(a for a in choice.curve.answers if a.criterion == "discrepancy").value is None


@pytest.mark.parametrize(
    ("sample", "reason"),
    [
        (np.zeros((3, 208)), "nothing to fit"),
        (np.full((1, 208), np.nan), "not a finite number"),
        (np.ones((2, 207)), "does not match 208"),
        (np.ones(208), "does not match 208"),
        (np.ones((0, 208)), "does not match 208"),
    ],
)
def test_samples_that_are_none_are_refused(problem, sample, reason):
    for method in (GaussNewtonTikhonov, TruncatedSvd):
        with pytest.raises(NumericsError, match=reason):
            method(choose="gcv").prepare(replace(problem, sample=sample))


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"choose": "taste"}, "it must be 'noise-figure', 'gcv', 'l-curve' or 'discrepancy'"),
        ({"choose": "gcv", "noise_figure": 1.0}, "not both"),
        ({"noise_figure": float("nan")}, "noise_figure is nan"),
    ],
)
@pytest.mark.parametrize("method", [*RIDGES, TruncatedSvd])
def test_options_that_say_nothing_are_refused(problem, method, options, reason):
    with pytest.raises((ConfigError, NumericsError), match=reason):
        method(**options).prepare(problem)


@pytest.mark.parametrize(
    ("method", "options", "reason"),
    [
        (GaussNewtonHighPass, {"width": 0.0}, r"width is 0\.0"),
        (GaussNewtonHighPass, {"width": 1e-9}, r"2.5 to 1e\+03 mm on this image"),
        (GaussNewtonHighPass, {"width": 1e200}, "positive finite"),
        (GaussNewtonNoser, {"exponent": 1.5}, "a number from 0 to 1"),
        (GaussNewtonIndenter, {"indenter_diameter_mm": 1e-300}, "positive finite"),
        (GaussNewtonIndenter, {"indenter_diameter_mm": 1e300}, "positive finite"),
        (GaussNewtonIndenter, {"indenter_diameter_mm": -13.0}, r"indenter_diameter_mm is -13\.0"),
        (TruncatedSvd, {"components": 0}, "components is 0"),
        (TruncatedSvd, {"components": 105}, "allowed: 1 to"),
        (TruncatedSvd, {"components": 20, "choose": "gcv"}, "not both"),
    ],
)
def test_options_of_single_methods_are_checked(problem, method, options, reason):
    with pytest.raises((ConfigError, NumericsError)) as refused:
        method(**options).prepare(problem)
    assert re.search(reason, str(refused.value))
    assert refused.value.remedy


@pytest.mark.parametrize("method", [*RIDGES, Greit, Temporal])
@pytest.mark.parametrize(
    "value", [-1.0, 1e200, 1.1e50, float("inf"), float("nan"), pytest.param(10**400, id="401 digits")]
)
def test_a_hyperparameter_beyond_what_can_be_computed_with_is_refused(problem, method, value):
    with pytest.raises((ConfigError, NumericsError), match="hyperparameter") as refused:
        method(hyperparameter=value)
    assert refused.value.remedy


@pytest.mark.parametrize("method", [*RIDGES, Greit])
def test_the_largest_hyperparameter_there_may_be_makes_a_finite_image(problem, method):
    prepared = method(hyperparameter=1e50).prepare(problem)
    assert np.isfinite(prepared.matrix).all()
    assert prepared.matrix.any()
    assert 0 < prepared.choice.noise_figure < np.inf


def test_an_indenter_smooths_over_its_own_width(problem):
    """Half the default's diameter is half the length; the default is 0.13 of the sheet's diameter."""
    default = GaussNewtonIndenter(hyperparameter=0.01).prepare(problem).matrix
    same, other = (
        GaussNewtonIndenter(hyperparameter=0.01, indenter_diameter_mm=width).prepare(problem).matrix
        for width in (13.0, 6.5)
    )
    assert np.array_equal(default, same)
    assert np.abs(other - default).max() > 0.1 * np.abs(default).max()


def test_truncation_is_the_singular_value_decomposition_in_the_sheets_own_norm(problem):
    """x = A^-½ V_k Σ_k⁻¹ U_kᵀ y of J A^-½, by numpy's own decomposition of all 208 readings."""
    areas = problem.mesh.areas_mm2
    left, values, right = np.linalg.svd(problem.jacobian / np.sqrt(areas), full_matrices=False)
    truncation = Truncation(problem)
    for components in truncation.cuts[[3, 12, 25]]:
        kept = slice(None, int(components))
        expected = (right[kept].T / np.sqrt(areas)[:, None] / values[kept]) @ left[:, kept].T
        found = truncation.matrix(int(components))
        assert np.abs(found - expected).max() < 1e-6 * np.abs(expected).max()


def test_truncation_splits_no_pair(problem):
    """On a round sheet patterns come with their turned twins."""
    truncation = Truncation(problem)
    values = np.linalg.svd(problem.jacobian / np.sqrt(problem.mesh.areas_mm2), compute_uv=False)
    for components in truncation.cuts[:-1]:
        assert values[components] < 0.98 * values[components - 1]
    split = next(k for k in range(1, 104) if k not in truncation.cuts)
    with pytest.raises(NumericsError, match="split a pair"):
        TruncatedSvd(components=split).prepare(problem)


def test_truncation_by_readings_follows_the_definitions(problem, measured):
    truncation, evidence = Truncation(problem), evidence_of(measured)
    fold = ReadingFold.from_problem(problem)
    readings = fold.fold(measured.sample)
    weight = 1 / fold.variance
    left = []
    for components in truncation.cuts:
        images = measured.sample @ truncation.matrix(int(components)).T
        left.append(((readings - images @ fold.rows(problem.jacobian).T) ** 2 * weight).sum())
    left = np.array(left)
    count = Truncation(problem).cuts[-1]
    by_gcv = int(np.argmin(left[:-1] / (count - truncation.cuts[:-1]) ** 2))
    assert TruncatedSvd(choose="gcv").prepare(measured).choice.value == truncation.cuts[by_gcv]
    enough = int(np.flatnonzero(left <= evidence.variance * 6 * 104)[0])
    assert TruncatedSvd(choose="discrepancy").prepare(measured).choice.value == truncation.cuts[enough]


def test_a_masked_sensor_keeps_no_half_pair(pin_sensor):
    sensor = pin_sensor()
    used = sensor.pattern.usable()
    used[3] = used[:, 3] = False
    masked = imaging_problem(sensor, used=used, image_size_mm=5.0)
    assert TruncatedSvd().prepare(masked).choice.value in Truncation(masked).cuts


def press_errors_mm(method, problem: ImagingProblem) -> np.ndarray:
    """How far 85 % masks of noisy presses (60 dB) lie from them, at 15 and 30 mm all around."""
    random, matrix, mesh = np.random.default_rng(1), method().prepare(problem).matrix, problem.mesh
    deviation = deviation_of(problem.nominal or problem)
    errors = []
    for radius in (15.0, 30.0):
        for angle in np.arange(0, 2 * np.pi, np.pi / 4):
            x, y = radius * np.cos(angle), radius * np.sin(angle)
            signal = target_signal(problem, x_mm=x, y_mm=y, radius_mm=6.5, contrast=0.2)
            image = matrix @ (signal + deviation * random.standard_normal(len(signal)))
            mass = np.where(image >= 0.85 * image.max(), mesh.areas_mm2, 0.0)
            errors.append(np.hypot(*(mass @ mesh.centroids_mm / mass.sum() - (x, y))))
    return np.array(errors)


@pytest.mark.parametrize(
    "dead",  # neighbours, of which the fewest readings are left, stay in make test
    [(3, 4, 5), *(pytest.param(dead, marks=pytest.mark.rest) for dead in ((3,), (3, 8), (3, 8, 13)))],
)
def test_truncation_with_bad_channels_makes_no_image_of_noise(pin_sensor, dead):
    """A count of components does not carry over to fewer readings."""
    sensor = pin_sensor()
    used = sensor.pattern.usable()
    for electrode in dead:
        used[sensor.pattern.drive_currents()[electrode] != 0] = False
        used[:, sensor.pattern.measure_matrix()[electrode] != 0] = False
    masked = imaging_problem(sensor, used=used, image_size_mm=5.0)
    assert np.median(press_errors_mm(TruncatedSvd, masked)) < 2.5 * np.median(
        press_errors_mm(GaussNewtonNoser, masked)
    )
    for options in ({}, {"choose": "gcv"}, {"choose": "discrepancy"}, {"noise_figure": 1.5}):
        of_type = TruncatedSvd(**options).prepare(imaging_problem(sensor, image_size_mm=5.0)).choice
        choice = TruncatedSvd(**options).prepare(masked).choice
        bound = options.get("noise_figure", of_type.noise_figure if options else 1.0)
        assert choice.noise_figure <= bound * (1 + 1e-9)
        further = Truncation(masked).cuts
        further = further[further > choice.value].astype(float)
        assert (Truncation(masked).noise_figures(further) > bound).all()
        said = f"{of_type.value:.0f} components there, chosen again on the {used.sum()} readings in use"
        assert said in choice.how
        assert choice.how.endswith(f"are {choice.value:.0f}, with {choice.noise_figure:.2f}")


def test_readings_that_are_all_noise_are_as_good_as_missing(pin_sensor):
    sensor = pin_sensor()
    used = sensor.pattern.usable()
    used[[2, 3, 7, 8, 12, 13]] = used[:, [2, 3, 7, 8, 12, 13]] = False
    usable = sensor.pattern.usable()
    loud = imaging_problem(sensor, noise_variance=np.where(used, 1.0, 1e10)[usable], image_size_mm=5.0)
    masked = imaging_problem(sensor, used=used, image_size_mm=5.0)
    one, other = (TruncatedSvd().prepare(each).choice for each in (loud, masked))
    assert one.value == pytest.approx(other.value, abs=4)
    assert "208 readings in use, weighted by their noise" in one.how


def test_a_noise_figure_that_no_truncation_keeps_within_is_refused(problem):
    with pytest.raises(NumericsError, match=r"no number of components reaches noise figure 1e-06") as refused:
        Truncation(problem).count_components(1e-6)
    assert "bad channels" in refused.value.remedy


def test_back_projection_is_the_normalised_transpose(problem):
    prepared = LinearBackProjection().prepare(problem)
    relative = problem.jacobian / problem.reference[:, None]
    readings = central_signal(problem, 0.2)
    expected = [s @ (readings / problem.reference) / np.linalg.norm(s) for s in relative.T]
    assert np.allclose(prepared.images(readings[None])[0], expected, rtol=1e-10)
    assert "nothing is regularised" in prepared.choice.how


def test_simulated_evidence_is_what_it_says(problem):
    evidence = evidence_of(problem)
    assert np.sqrt(evidence.variance) == pytest.approx(deviation_of(problem), rel=1e-12)
    scatter = evidence.changes - central_signal(problem, 0.2)
    assert scatter.std() == pytest.approx(deviation_of(problem), rel=0.05)
    assert ReadingFold.from_problem(problem).noise(evidence.changes)[0] == pytest.approx(evidence.variance, rel=0.1)


def test_targets_are_named_in_three_digits(pin_sensor):
    problem = imaging_problem(pin_sensor(radius_mm=35.17), image_size_mm=5.0)
    for criterion in ("noise-figure", "gcv"):
        assert "central target of 9.14 mm" in GaussNewtonNoser(choose=criterion).prepare(problem).choice.how
