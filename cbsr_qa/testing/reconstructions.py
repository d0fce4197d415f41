"""Conformance of reconstruction plugins: what an image must do whatever the method.

Each check can be run by itself as well; those that do not apply are returned with the reason.
"""

from collections.abc import Iterator
from functools import partial

import numpy as np

from cbsr_qa.domain.errors import CbsrError
from cbsr_qa.domain.imaging import ImagingProblem, PreparedReconstruction
from cbsr_qa.domain.numbers import Array
from cbsr_qa.testing.checked import COMMON, Checked, Tolerances, demand, describe_failure, is_linear, relative
from cbsr_qa.testing.reconstructed_targets import (
    Factory,
    check_masked_electrodes,
    check_noise_propagation,
    check_noise_weighing,
    check_places_and_signs,
    check_turn,
)
from cbsr_qa.testing.targets import CONTRAST, PLACES, example_problem, images_elsewhere, noise, signal


def check_reconstruction(
    factory: Factory, *, tolerances: Tolerances | None = None, elsewhere: bool = True
) -> tuple[Checked, ...]:
    """Run every check that applies to a method.

    - Images of targets of either sign show them in their places, with all readings and with three electrodes masked.
    - A target rotated by one electrode on an exactly symmetric mesh gives a rotated image.
    - A second image, a second preparation and, with ``elsewhere``, another process with two threads give the same.
    - Readings that are not numbers are refused.
    - Methods with one matrix, and those with an attribute ``linear = True``, are linear, and the covariance of
      imaged noise is the propagated one.

    Parameters
    ----------
    factory : called without arguments for each preparation; ``functools.partial`` gives it options.
    tolerances : None for the common ones.
    elsewhere : whether to ask a fresh process too, which needs a factory that a module holds by name.

    Returns
    -------
    One :class:`Checked` for each check, with the figures found.

    Raises
    ------
    AssertionError
        Naming the method, what it did and what was allowed.
    """
    return tuple(check() for check in reconstruction_checks(factory, tolerances=tolerances, elsewhere=elsewhere))


def reconstruction_checks(
    factory: Factory, *, tolerances: Tolerances | None = None, elsewhere: bool = True
) -> Iterator[partial[Checked]]:
    """Yield the checks of :func:`check_reconstruction`, to be called one by one; parameters as there."""
    allowed, problem = tolerances or COMMON, example_problem()
    prepared = factory().prepare(problem)
    yield partial(check_description, prepared, problem)
    yield partial(check_nothing_changes_nothing, prepared)
    yield partial(check_linearity, prepared, tolerance=allowed.linearity)
    yield partial(check_places_and_signs, prepared, tolerance=allowed.place)
    yield partial(check_turn, factory, image_tolerance=allowed.turned_image, place_tolerance=allowed.turned_place)
    yield partial(check_repeatable, factory, prepared)
    yield partial(check_masked_electrodes, factory, tolerance=allowed.masked_place)
    yield partial(check_noise_propagation, prepared)
    yield partial(check_noise_weighing, factory, prepared)
    yield partial(check_refusals, prepared)
    if elsewhere:
        yield partial(check_same_elsewhere, factory, prepared, tolerance=allowed.threads)


def check_description(prepared: PreparedReconstruction, problem: ImagingProblem) -> Checked:
    """A prepared method states its name, its problem, and the reason for its parameter.

    Remedy: give the prepared method ``method``, the ``problem`` it got, and a ``ParameterChoice`` with name and
    ``how``.
    """
    choice = prepared.choice
    demand(prepared, bool(prepared.method), "has no name")
    demand(prepared, prepared.problem is problem, "does not hold the problem it was prepared for")
    demand(prepared, bool(choice.name and choice.how), "does not say what its parameter is or how it was chosen")
    demand(prepared, bool(np.isfinite(choice.value)), f"has a parameter of {choice.value}")
    demand(
        prepared,
        bool(np.isfinite(choice.noise_figure) and choice.noise_figure > 0),
        f"states a noise figure of {choice.noise_figure}",
    )
    return Checked("description", f"{choice.name} = {choice.value:.4g}: {choice.how}")


def check_nothing_changes_nothing(prepared: PreparedReconstruction) -> Checked:
    """Readings that equal the reference give an image of zeros, not of noise.

    Remedy: return exactly zero for readings equal to the reference; check for an offset or noise that is added.
    """
    largest = float(np.abs(prepared.images(np.zeros((2, len(prepared.problem.reference))))).max())
    demand(prepared, largest == 0, f"makes an image of up to {largest:.3g} out of no change at all")
    return Checked("nothing changes nothing", "zero")


def check_linearity(prepared: PreparedReconstruction, *, tolerance: float = COMMON.linearity) -> Checked:
    """Images of a sum are the sum of the images, for blocks of three frames; where the method claims it.

    Remedy: remove the nonlinear step, or do not claim ``linear``.
    """
    if not is_linear(prepared):
        return Checked("linearity", "the method does not claim it", applies=False)
    random = np.random.default_rng(5)
    first, second = (noise(prepared.problem, random, 3) for _ in range(2))
    summed = prepared.images(2.5 * first - second)
    apart = 2.5 * prepared.images(first) - prepared.images(second)
    departure = relative(summed, apart)
    demand(prepared, departure <= tolerance, f"is not linear: departs by {departure:.3g}, allowed {tolerance:.3g}")
    return Checked("linearity", f"departs by {departure:.1e}")


def check_repeatable(factory: Factory, prepared: PreparedReconstruction) -> Checked:
    """Prepared and applied again, a method gives identical images.

    Remedy: draw random numbers from a fixed seed, and keep no state between calls.
    """
    readings = elsewhere_readings(prepared.problem)
    first = prepared.images(readings)
    demand(prepared, np.array_equal(first, prepared.images(readings)), "gives another image when asked twice")
    again = factory().prepare(prepared.problem).images(readings)
    demand(prepared, np.array_equal(first, again), "gives another image when prepared twice")
    return Checked("repeatable", "to the bit")


def check_same_elsewhere(
    factory: Factory, prepared: PreparedReconstruction, *, tolerance: float = COMMON.threads
) -> Checked:
    """A fresh process with two threads and another hash seed gives the same images, but for rounding.

    Remedy: draw random numbers from a fixed seed, iterate over no set, and keep the factory importable by name.
    """
    readings = elsewhere_readings(prepared.problem)
    (there,) = images_elsewhere([factory], prepared.problem, readings, threads=2)
    return compare_elsewhere(prepared, there, tolerance=tolerance)


def compare_elsewhere(
    prepared: PreparedReconstruction, there: Array, *, tolerance: float = COMMON.threads
) -> Checked:
    """Compare with images that another process made from :func:`elsewhere_readings`."""
    departure = relative(there, prepared.images(elsewhere_readings(prepared.problem)))
    demand(prepared, departure <= tolerance, f"differs between processes by {departure:.3g}, allowed {tolerance:.3g}")
    return Checked("same elsewhere", f"differs by {departure:.1e}")


def check_refusals(prepared: PreparedReconstruction) -> Checked:
    """Readings that are no real numbers, or too few, are refused by name; no frames make no images.

    Remedy: check shape and type of the readings first, and raise ``NumericsError`` or another ``CbsrError``
    with a reason.
    """
    good = elsewhere_readings(prepared.problem)
    holed = {name: good.copy() for name in ("NaN", "infinity")}
    holed["NaN"][1, 3], holed["infinity"][0, 7] = np.nan, np.inf
    kinds = {"complex numbers": good * (1 + 0.1j), "text": good.astype(str)}
    wrong = {**holed, **kinds, "one reading less": good[:, 1:], "a frame without a block": good[0]}
    none = prepared.images(good[:0])
    demand(prepared, none.shape == (0, len(prepared.problem.mesh.elements)), f"makes {none.shape} of no frames")
    for name, readings in wrong.items():
        try:
            prepared.images(readings)
        except CbsrError as error:
            demand(prepared, bool(error.reason), f"refuses {name} without saying why")
        except Exception as error:
            raise AssertionError(
                describe_failure(prepared, f"meets {name} with {type(error).__name__}: {error}")
            ) from error
        else:
            demand(prepared, False, f"makes an image of {name}")
    return Checked("refusals", ", ".join(wrong))


def elsewhere_readings(problem: ImagingProblem) -> Array:
    """Readings (3, m) that processes are compared with: noise, and a target in noise."""
    readings = noise(problem, np.random.default_rng(3), 3)
    readings[1:] += signal(problem, PLACES[1], CONTRAST)
    return readings
