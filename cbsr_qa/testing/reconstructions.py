"""Conformance of reconstruction plugins: what an image must do whatever the method.

:func:`check_reconstruction` runs everything that applies to a method; each check can be run by itself as well. A
check that fails raises AssertionError and says which method did what where. Checks that do not apply are named in
what is returned, with the reason: nothing is passed over in silence.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from cbsr_qa.domain import Array, CbsrError, Mask
from cbsr_qa.domain.results import ImagingProblem, LinearReconstruction, PreparedReconstruction
from cbsr_qa.eit.inverse import changes, scale_of
from cbsr_qa.plugin import Reconstruction
from cbsr_qa.testing.targets import (
    CONTRAST,
    PLACES,
    SymmetricProblem,
    blob_centre,
    example_problem,
    found_at,
    images_elsewhere,
    noise,
    noise_deviation,
    signal,
    symmetric_problem,
)

Factory = Callable[[], Reconstruction]

_MASKED = (2, 7, 12)  # electrodes whose readings are all left out


@dataclass(frozen=True, slots=True)
class Tolerances:
    """How far a method may be off. A method that needs more states it where it is checked.

    Parameters
    ----------
    place : distance of a blob's centre from the target's, of the sheet's radius.
    masked_place : the same with three electrodes masked.
    linearity : relative departure of images from linearity, where it is claimed.
    turned_image : relative difference between the turned image and the image of the turned target, on a mesh that is
        exactly symmetric. Methods that see the problem's own numbers alone reach rounding.
    turned_place : distance of the two blobs' centres, of the sheet's radius.
    threads : relative difference between images of processes with one and two threads.
    """

    place: float = 0.1
    masked_place: float = 0.15
    linearity: float = 1e-9
    turned_image: float = 1e-6
    turned_place: float = 1e-6
    threads: float = 1e-8


_COMMON = Tolerances()


@dataclass(frozen=True, slots=True)
class Checked:
    """What came of one check.

    Parameters
    ----------
    check : its name.
    found : the figure that was compared, in words; or why the check does not apply.
    applies : False where it was not made.
    """

    check: str
    found: str
    applies: bool = True


def check_reconstruction(
    factory: Factory, *, tolerances: Tolerances | None = None, elsewhere: bool = True
) -> tuple[Checked, ...]:
    """Run every check that applies to a method.

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
    allowed, problem = tolerances or _COMMON, example_problem()
    prepared = factory().prepare(problem)
    done = [
        check_description(prepared, problem),
        check_nothing_changes_nothing(prepared),
        check_linearity(prepared, tolerance=allowed.linearity),
        check_places_and_signs(prepared, tolerance=allowed.place),
        check_turn(factory, image_tolerance=allowed.turned_image, place_tolerance=allowed.turned_place),
        check_repeatable(factory, prepared),
        check_masked_electrodes(factory, tolerance=allowed.masked_place),
        check_noise_propagation(prepared),
        check_noise_weighing(factory, prepared),
        check_refusals(prepared),
    ]
    if elsewhere:
        done.append(check_same_elsewhere(factory, prepared, tolerance=allowed.threads))
    return tuple(done)


def is_linear(prepared: PreparedReconstruction) -> bool:
    """Whether a method claims that its images of a block of frames are linear in the block."""
    return isinstance(prepared, LinearReconstruction) or bool(getattr(prepared, "linear", False))


def check_description(prepared: PreparedReconstruction, problem: ImagingProblem) -> Checked:
    """A prepared method says what it is, what it was prepared for, and why its parameter has its value."""
    choice = prepared.choice
    _demand(prepared, bool(prepared.method), "has no name")
    _demand(prepared, prepared.problem is problem, "does not hold the problem it was prepared for")
    _demand(prepared, bool(choice.name and choice.how), "does not say what its parameter is or how it was chosen")
    _demand(prepared, bool(np.isfinite(choice.value)), f"has a parameter of {choice.value}")
    _demand(
        prepared,
        bool(np.isfinite(choice.noise_figure) and choice.noise_figure > 0),
        f"states a noise figure of {choice.noise_figure}",
    )
    return Checked("description", f"{choice.name} = {choice.value:.4g}: {choice.how}")


def check_nothing_changes_nothing(prepared: PreparedReconstruction) -> Checked:
    """Readings that equal the reference give an image of zeros, not of noise."""
    largest = float(np.abs(prepared.images(np.zeros((2, len(prepared.problem.reference))))).max())
    _demand(prepared, largest == 0, f"makes an image of up to {largest:.3g} out of no change at all")
    return Checked("nothing changes nothing", "zero")


def check_linearity(prepared: PreparedReconstruction, *, tolerance: float = _COMMON.linearity) -> Checked:
    """Images of a sum are the sum of the images, for blocks of three frames; where the method claims it."""
    if not is_linear(prepared):
        return Checked("linearity", "the method does not claim it", applies=False)
    random = np.random.default_rng(5)
    first, second = (noise(prepared.problem, random, 3) for _ in range(2))
    summed = prepared.images(2.5 * first - second)
    apart = 2.5 * prepared.images(first) - prepared.images(second)
    departure = _relative(summed, apart)
    _demand(prepared, departure <= tolerance, f"is not linear: departs by {departure:.3g}, allowed {tolerance:.3g}")
    return Checked("linearity", f"departs by {departure:.1e}")


def check_places_and_signs(prepared: PreparedReconstruction, *, tolerance: float = _COMMON.place) -> Checked:
    """A target that conducts more is a positive blob where the target is, less a negative one, and it moves along.

    Parameters
    ----------
    tolerance : distance between centres, of the sheet's radius. The blob's step from one place to the next must also
        make an angle of less than 45° with the target's.
    """
    problem = prepared.problem
    radius, worst = problem.sensor_type.radius_mm, 0.0
    for sign in (1, -1):
        centres = [found_at(prepared, at, sign * CONTRAST) for at in PLACES]
        wanted = [radius * np.array(at) for at in PLACES]
        for centre, place in zip(centres, wanted, strict=True):
            distance = float(np.hypot(*(centre - place))) / radius
            worst = max(worst, distance)
            _demand(
                prepared,
                distance <= tolerance,
                f"puts a target of {sign * CONTRAST:+.0%} at {_mm(place)} to {_mm(centre)},"
                f" {distance:.3f} of the radius away, allowed {tolerance:.3g}",
            )
        for step, wanted_step in zip(np.diff(centres, axis=0), np.diff(wanted, axis=0), strict=True):
            along = float(step @ wanted_step / (np.hypot(*step) * np.hypot(*wanted_step)))
            _demand(
                prepared,
                along > np.sqrt(0.5),
                f"moves a blob by {_mm(step)} where the target moves by {_mm(wanted_step)}",
            )
    return Checked("places and signs", f"worst {worst * radius:.2f} mm from its place")


def check_turn(
    factory: Factory,
    *,
    image_tolerance: float = _COMMON.turned_image,
    place_tolerance: float = _COMMON.turned_place,
    symmetric: SymmetricProblem | None = None,
) -> Checked:
    """A target one electrode further gives the same image one electrode further, on a symmetric mesh."""
    symmetric = symmetric or symmetric_problem()
    problem, prepared = symmetric.problem, factory().prepare(symmetric.problem)
    radius, mesh = problem.sensor_type.radius_mm, problem.mesh
    target = np.hypot(*(mesh.centroids_mm - radius * np.array([0.4, 0.15])).T) < 0.2 * radius
    readings = problem.jacobian @ np.where(target, 0.1, 0.0)
    image = symmetric.turn_image(prepared.images(readings[None])[0])
    turned = prepared.images(symmetric.turn_readings(readings)[None])[0]
    departure = _relative(turned, image)
    apart = float(np.hypot(*(blob_centre(prepared, turned) - blob_centre(prepared, image)))) / radius
    difference = f"image {departure:.2g}, centre {apart * radius:.2g} mm"
    _demand(
        prepared,
        departure <= image_tolerance and apart <= place_tolerance,
        f"turns the image otherwise than the target: off by {difference},"
        f" allowed {image_tolerance:.2g}, {place_tolerance * radius:.2g} mm",
    )
    return Checked("turn by one electrode", f"off by {difference}")


def check_repeatable(factory: Factory, prepared: PreparedReconstruction) -> Checked:
    """Prepared again, and asked again, a method gives the same images to the last bit."""
    readings = elsewhere_readings(prepared.problem)
    first = prepared.images(readings)
    _demand(prepared, np.array_equal(first, prepared.images(readings)), "gives another image when asked twice")
    again = factory().prepare(prepared.problem).images(readings)
    _demand(prepared, np.array_equal(first, again), "gives another image when prepared twice")
    return Checked("repeatable", "to the bit")


def check_same_elsewhere(
    factory: Factory, prepared: PreparedReconstruction, *, tolerance: float = _COMMON.threads
) -> Checked:
    """A fresh process with two threads and another hash seed gives the same images, but for rounding."""
    readings = elsewhere_readings(prepared.problem)
    (there,) = images_elsewhere([factory], prepared.problem, readings, threads=2)
    return compare_elsewhere(prepared, there, tolerance=tolerance)


def compare_elsewhere(
    prepared: PreparedReconstruction, there: Array, *, tolerance: float = _COMMON.threads
) -> Checked:
    """Compare with images another process made of :func:`elsewhere_readings`."""
    departure = _relative(there, prepared.images(elsewhere_readings(prepared.problem)))
    _demand(
        prepared, departure <= tolerance, f"differs between processes by {departure:.3g}, allowed {tolerance:.3g}"
    )
    return Checked("same elsewhere", f"differs by {departure:.1e}")


def check_masked_electrodes(factory: Factory, *, tolerance: float = _COMMON.masked_place) -> Checked:
    """With three electrodes masked a target is still found, and what they read is never looked at."""
    sensor = example_problem().sensor_type
    touched = np.array(
        [
            [bool({*drive, *measure} & set(_MASKED)) for measure in sensor.pattern.measure]
            for drive in sensor.pattern.drive
        ]
    )
    problem = example_problem(used=sensor.pattern.usable() & ~touched)
    prepared = factory().prepare(problem)
    radius, worst = sensor.radius_mm, 0.0
    for place in PLACES[:2]:
        worst = max(
            worst, float(np.hypot(*(found_at(prepared, place, CONTRAST) - radius * np.array(place)))) / radius
        )
    _demand(
        prepared,
        worst <= tolerance,
        f"puts a target {worst:.3f} of the radius away with electrodes {_MASKED} masked, allowed {tolerance:.3g}",
    )
    first, second = (_image_with(prepared, touched, value) for value in (np.nan, 1e6))
    _demand(prepared, np.array_equal(first, second), "looks at readings that are masked")
    return Checked("masked electrodes", f"worst {worst * radius:.2f} mm from its place, masked readings unseen")


def check_noise_propagation(prepared: PreparedReconstruction, *, draws: int = 2000) -> Checked:
    """The covariance of images of noise is R Σ Rᵀ within sampling error; for linear methods.

    R is taken from images of unit changes, a block of two frames at a time; Σ has unequal variances and a part common
    to all channels. With N draws of covariance C the sample's departs by √((tr²C + ‖C‖²)/N) in the mean (Wishart).
    """
    if not is_linear(prepared):
        return Checked("noise propagation", "the method is not linear: its noise depends on the image", applies=False)
    random, count = np.random.default_rng(17), len(prepared.problem.reference)
    deviation = noise_deviation(prepared.problem)
    blocks = random.standard_normal((draws, 2, count)) * deviation + random.standard_normal((draws, 2, 1)) * deviation
    units = np.eye(2 * count).reshape(2 * count, 2, count)
    matrix, images = (
        np.array([prepared.images(block).ravel() for block in some]) for some in (units, blocks)
    )  # (2m, 2e), (draws, 2e)
    of_frame = np.diag(deviation**2) + np.outer(deviation, deviation)
    expected = matrix.T @ np.kron(np.eye(2), of_frame) @ matrix
    sampled = images.T @ images / draws
    error = np.sqrt((np.trace(expected) ** 2 + np.sum(expected**2)) / draws)
    ratio = float(np.linalg.norm(sampled - expected) / error)
    _demand(prepared, ratio < 1.5, f"has noise whose covariance is {ratio:.2f} sampling errors from R Σ Rᵀ")
    return Checked("noise propagation", f"{ratio:.2f} sampling errors of {draws} draws")


def check_noise_weighing(factory: Factory, prepared: PreparedReconstruction) -> Checked:
    """Loud readings count less where the problem says that they are; of what runs can use, one matrix.

    By the propagated noise tr(R Σ Rᵀ) of a matrix prepared for those variances, against one for equal ones. A method
    that lets all readings count alike says so (``weighs_noise = False``).
    """
    if not isinstance(prepared, LinearReconstruction):
        return Checked("noise weighing", "the method is not one matrix, and no run can use it", applies=False)
    if not getattr(factory(), "weighs_noise", True):
        return Checked("noise weighing", "the method says that it lets all readings count alike", applies=False)
    problem, loud = prepared.problem, np.ones(len(prepared.problem.reference))
    loud[: len(loud) // 8] = 100.0
    variance = loud * (1 / loud).mean()
    weighed = factory().prepare(replace(problem, noise_variance=variance, nominal=problem.nominal or problem))
    units = np.eye(len(loud))
    after, before = (float((method.images(units) ** 2).sum(axis=1) @ variance) for method in (weighed, prepared))
    _demand(
        prepared,
        after < 0.9 * before,
        f"does not weigh readings by their noise: loud ones leave {after / before:.3g} of the noise of equal weights",
    )
    return Checked("noise weighing", f"loud readings leave {after / before:.2g} of the noise of equal weights")


def check_refusals(prepared: PreparedReconstruction) -> Checked:
    """Readings that are no real numbers, or too few, are refused by name; no frames make no images."""
    good = elsewhere_readings(prepared.problem)
    holed = {name: good.copy() for name in ("NaN", "infinity")}
    holed["NaN"][1, 3], holed["infinity"][0, 7] = np.nan, np.inf
    kinds = {"complex numbers": good * (1 + 0.1j), "text": good.astype(str)}
    wrong = {**holed, **kinds, "one reading less": good[:, 1:], "a frame without a block": good[0]}
    none = prepared.images(good[:0])
    _demand(prepared, none.shape == (0, len(prepared.problem.mesh.elements)), f"makes {none.shape} of no frames")
    for name, readings in wrong.items():
        try:
            prepared.images(readings)
        except CbsrError as error:
            _demand(prepared, bool(error.reason), f"refuses {name} without saying why")
        except Exception as error:
            raise AssertionError(f"{prepared.method} meets {name} with {type(error).__name__}: {error}") from error
        else:
            raise AssertionError(f"{prepared.method} makes an image of {name}")
    return Checked("refusals", ", ".join(wrong))


def elsewhere_readings(problem: ImagingProblem) -> Array:
    """Readings (3, m) that processes are compared with: noise, and a target in noise."""
    readings = noise(problem, np.random.default_rng(3), 3)
    readings[1:] += signal(problem, PLACES[1], CONTRAST)
    return readings


def _image_with(prepared: PreparedReconstruction, masked: Mask, value: float) -> Array:
    """Image of a target, by way of whole frames that read a value wherever they are masked."""
    problem = prepared.problem
    reference = np.where(masked, value, 0.0)
    reference[problem.used] = problem.reference
    frame = reference.copy()
    frame[problem.used] += signal(problem, PLACES[1], CONTRAST)
    return prepared.images(changes(frame[None], reference, problem, scale_of(reference, problem)))


def _relative(a: Array, b: Array) -> float:
    """Distance in the largest norm, relative to the larger of the two."""
    scale = max(float(np.abs(a).max()), float(np.abs(b).max()))
    return float(np.abs(a - b).max()) / scale if scale else 0.0


def _mm(place: Array) -> str:
    return f"({place[0]:.1f}, {place[1]:.1f}) mm"


def _demand(prepared: PreparedReconstruction, holds: bool, otherwise: str) -> None:
    if not holds:
        raise AssertionError(f"{prepared.method} {otherwise}")
