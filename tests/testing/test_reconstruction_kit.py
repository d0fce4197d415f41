"""The conformance kit passes a good method and names what is wrong with each bad one."""

import os
from dataclasses import dataclass, replace

import numpy as np
import pytest

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.imaging import ImagingProblem, LinearReconstruction, ParameterChoice
from cbsr_qa.testing.reconstructed_targets import (
    check_masked_electrodes,
    check_noise_propagation,
    check_noise_weighing,
)
from cbsr_qa.testing.reconstructions import check_reconstruction, check_same_elsewhere
from cbsr_qa.testing.targets import example_problem, images_elsewhere, symmetric_problem

_RIDGE = 1e-3


class Plain:
    """One-step Gauss-Newton with a fixed parameter: nothing a check could find fault with."""

    def prepare(self, problem: ImagingProblem) -> LinearReconstruction:
        back = problem.jacobian.T / np.linalg.norm(problem.jacobian, axis=0)[:, None]
        normal = problem.jacobian @ back
        noise = np.ones(len(normal)) if problem.noise_variance is None else problem.noise_variance
        normal.flat[:: len(normal) + 1] += _RIDGE * np.trace(normal) / len(normal) * noise
        choice = ParameterChoice(_RIDGE, "given", 1.0)
        return LinearReconstruction("plain", problem, np.linalg.solve(normal, back.T).T, choice)


@dataclass
class Spoilt:
    """A good method whose images are made otherwise."""

    good: LinearReconstruction
    wrong: object
    linear: bool
    choice: ParameterChoice
    method: str = "spoilt"

    @property
    def problem(self):
        return self.good.problem

    def images(self, changes):
        return self.wrong(self.good, changes)


def spoilt(wrong, *, linear=False, how="given"):
    class Factory:
        def prepare(self, problem):
            return Spoilt(Plain().prepare(problem), wrong, linear, ParameterChoice(_RIDGE, how, 1.0))

    return Factory


class OfThreads:
    """Depends on how many threads there are."""

    def prepare(self, problem):
        good = Plain().prepare(problem)
        factor = float(os.environ["OMP_NUM_THREADS"])
        return LinearReconstruction("of threads", problem, factor * good.matrix, good.choice)


class BreaksElsewhere:
    def prepare(self, problem):
        raise OSError("no such thing here")


def _good(good, changes):
    return good.images(changes)


def _shifted(good, changes):
    places = good.problem.mesh.centroids_mm
    from_here = np.argmin(((places[:, None] - [12.0, 0.0] - places[None]) ** 2).sum(axis=2), axis=1)
    return good.images(changes)[:, from_here]


def _one_side_brighter(good, changes):
    x, y = good.problem.mesh.centroids_mm.T
    return good.images(changes) * (1 + 1e-4 * (x > y))


_ASKED = []


def _counts(good, changes):
    _ASKED.append(1)
    return good.images(changes) * (1 + 1e-12 * len(_ASKED))


def _saturated(good, changes):
    return good.images(np.clip(changes, -1e-2, 1e-2))


def _blind_to_nan(good, changes):
    return np.nan_to_num(changes) @ good.matrix.T


def _breaks(good, changes):
    if not np.isfinite(changes).all():
        raise FloatingPointError("invalid value")
    return good.images(changes)


def test_a_good_method_passes_everything():
    done = check_reconstruction(Plain)
    assert len(done) == 11
    assert all(checked.applies for checked in done)


def test_what_does_not_apply_is_said():
    done = check_reconstruction(spoilt(_good), elsewhere=False)
    assert {c.check: c.found for c in done if not c.applies} == {
        "linearity": "the method does not claim it",
        "noise propagation": "the method is not linear: its noise depends on the image",
        "noise weighing": "the method is not one matrix, and no run can use it",
    }


class Deaf(Plain):
    """Does not look at the readings' noise."""

    def prepare(self, problem):
        return replace(super().prepare(replace(problem, noise_variance=None)), problem=problem)


def test_a_method_that_does_not_weigh_readings_must_say_so():
    prepared = Deaf().prepare(example_problem())
    with pytest.raises(AssertionError, match="plain does not weigh readings by their noise: loud ones leave 1 of"):
        check_noise_weighing(Deaf, prepared)
    frank = type("Frank", (Deaf,), {"weighs_noise": False})
    assert not check_noise_weighing(frank, prepared).applies


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda good, changes: -good.images(changes), "with the other sign"),
        (lambda good, changes: np.abs(good.images(changes)), "with the other sign"),
        (_shifted, "of the radius away, allowed 0.1"),
        (_one_side_brighter, "turns the image otherwise than the target"),
        (lambda good, changes: good.images(changes) + 1e-9, "out of no change at all"),
        (lambda good, changes: good.images(changes)[:, :-1], "images of shape"),
        (lambda good, changes: good.images(changes) / (changes.any(axis=1, keepdims=True) - 1.0), "not finite"),
        (_counts, "when asked twice"),
        (_blind_to_nan, "makes an image of NaN"),
        (_breaks, "meets NaN with FloatingPointError: invalid value"),
    ],
)
@pytest.mark.filterwarnings("ignore:divide by zero", "ignore:invalid value")
def test_what_is_wrong_is_named(wrong, message):
    with pytest.raises(AssertionError, match=message):
        check_reconstruction(spoilt(wrong), elsewhere=False)


def test_linearity_that_is_claimed_is_checked():
    with pytest.raises(AssertionError, match="is not linear"):
        check_reconstruction(spoilt(lambda good, y: good.images(y) * (1 + np.abs(y).max()), linear=True))


def test_a_parameter_without_a_reason_is_a_fault():
    with pytest.raises(AssertionError, match="how it was chosen"):
        check_reconstruction(spoilt(_good, how=""))


def test_noise_that_is_not_the_propagated_one_is_a_fault():
    prepared = spoilt(_good, linear=True)().prepare(example_problem())
    check_noise_propagation(prepared)
    prepared.wrong = lambda good, y: good.images(y) if np.count_nonzero(y) == 1 else 1.1 * good.images(y)
    with pytest.raises(AssertionError, match="sampling errors"):
        check_noise_propagation(prepared)


def test_a_method_that_needs_every_electrode_is_a_fault():
    def lost(good, y):
        return (
            good.images(y) if y.shape[1] == 208 else _shifted(good, _blind_to_nan(good, y) @ good.problem.jacobian.T)
        )

    with pytest.raises(AssertionError, match="masked"):
        check_masked_electrodes(spoilt(lost))


@pytest.mark.rest
def test_a_method_that_feels_the_threads_is_a_fault():
    with pytest.raises(AssertionError, match="between processes"):
        check_same_elsewhere(OfThreads, OfThreads().prepare(example_problem()))


@pytest.mark.rest
def test_what_another_process_says_is_passed_on():
    problem = symmetric_problem().problem
    nothing = np.zeros((1, 208))
    with pytest.raises(RefusedError, match="no such thing here"):
        images_elsewhere([BreaksElsewhere], problem, nothing, threads=1)
    with pytest.raises(RefusedError, match="a module holds by name"):
        images_elsewhere([spoilt(_good)], problem, nothing, threads=1)


def test_the_symmetric_problem_is_symmetric_to_rounding():
    symmetric = symmetric_problem()
    image = np.random.default_rng(1).standard_normal(len(symmetric.turned))
    turned = symmetric.problem.jacobian @ symmetric.turn_image(image)
    expected = symmetric.turn_readings(symmetric.problem.jacobian @ image)
    assert np.abs(turned - expected).max() < 1e-12 * np.abs(expected).max()
    assert not np.array_equal(turned, symmetric.problem.jacobian @ image)
