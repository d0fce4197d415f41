"""Conformance of reconstruction plugins: where their images show targets, and what noise does to them."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from cbsr_qa.domain.imaging import LinearReconstruction, PreparedReconstruction
from cbsr_qa.domain.numbers import Array, Mask
from cbsr_qa.eit.inverse.scaling import changes, scale_of
from cbsr_qa.plugin.interfaces import Reconstruction
from cbsr_qa.testing.checked import COMMON, Checked, demand, is_linear, relative
from cbsr_qa.testing.targets import (
    CONTRAST,
    PLACES,
    SymmetricProblem,
    blob_centre,
    example_problem,
    locate_target,
    noise_deviation,
    signal,
    symmetric_problem,
)

Factory = Callable[[], Reconstruction]

_MASKED = (2, 7, 12)  # electrodes whose readings are all left out


def check_places_and_signs(prepared: PreparedReconstruction, *, tolerance: float = COMMON.place) -> Checked:
    """A target that conducts more is a positive blob where the target is, less a negative one, and it moves along.

    Remedy: check the sign of the matrix and the order of readings; state wider ``tolerances`` if the method
    blurs.

    Parameters
    ----------
    tolerance : distance between centres, of the sheet's radius. The blob's step from one place to the next must also
        make an angle of less than 45° with the target's.
    """
    problem = prepared.problem
    radius, worst = problem.sensor_type.radius_mm, 0.0
    for sign in (1, -1):
        centres = [locate_target(prepared, at, sign * CONTRAST) for at in PLACES]
        wanted = [radius * np.array(at) for at in PLACES]
        for centre, place in zip(centres, wanted, strict=True):
            distance = float(np.hypot(*(centre - place))) / radius
            worst = max(worst, distance)
            demand(
                prepared,
                distance <= tolerance,
                f"puts a target of {sign * CONTRAST:+.0%} at {_mm(place)} to {_mm(centre)},"
                f" {distance:.3f} of the radius away, allowed {tolerance:.3g}",
            )
        for step, wanted_step in zip(np.diff(centres, axis=0), np.diff(wanted, axis=0), strict=True):
            along = float(step @ wanted_step / (np.hypot(*step) * np.hypot(*wanted_step)))
            demand(
                prepared,
                along > np.sqrt(0.5),
                f"moves a blob by {_mm(step)} where the target moves by {_mm(wanted_step)}",
            )
    return Checked("places and signs", f"worst {worst * radius:.2f} mm from its place")


def check_turn(
    factory: Factory,
    *,
    image_tolerance: float = COMMON.turned_image,
    place_tolerance: float = COMMON.turned_place,
    symmetric: SymmetricProblem | None = None,
) -> Checked:
    """A target one electrode further gives the same image one electrode further, on a symmetric mesh.

    Remedy: treat all electrodes alike; state wider ``tolerances`` if the method uses a grid of its own.
    """
    symmetric = symmetric or symmetric_problem()
    problem, prepared = symmetric.problem, factory().prepare(symmetric.problem)
    radius, mesh = problem.sensor_type.radius_mm, problem.mesh
    target = np.hypot(*(mesh.centroids_mm - radius * np.array([0.4, 0.15])).T) < 0.2 * radius
    readings = problem.jacobian @ np.where(target, 0.1, 0.0)
    image = symmetric.turn_image(prepared.images(readings[None])[0])
    turned = prepared.images(symmetric.turn_readings(readings)[None])[0]
    departure = relative(turned, image)
    apart = float(np.hypot(*(blob_centre(prepared, turned) - blob_centre(prepared, image)))) / radius
    difference = f"image {departure:.2g}, centre {apart * radius:.2g} mm"
    demand(
        prepared,
        departure <= image_tolerance and apart <= place_tolerance,
        f"turns the image otherwise than the target: off by {difference},"
        f" allowed {image_tolerance:.2g}, {place_tolerance * radius:.2g} mm",
    )
    return Checked("turn by one electrode", f"off by {difference}")


def check_masked_electrodes(factory: Factory, *, tolerance: float = COMMON.masked_place) -> Checked:
    """With three electrodes masked a target is still found, and their readings are not used.

    Remedy: use only the readings in ``problem.used``, and take their number from the problem.
    """
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
            worst, float(np.hypot(*(locate_target(prepared, place, CONTRAST) - radius * np.array(place)))) / radius
        )
    demand(
        prepared,
        worst <= tolerance,
        f"puts a target {worst:.3f} of the radius away with electrodes {_MASKED} masked, allowed {tolerance:.3g}",
    )
    first, second = (_image_with(prepared, touched, value) for value in (np.nan, 1e6))
    demand(prepared, np.array_equal(first, second), "looks at readings that are masked")
    return Checked("masked electrodes", f"worst {worst * radius:.2f} mm from its place, masked readings unseen")


def check_noise_propagation(prepared: PreparedReconstruction, *, draws: int = 2000) -> Checked:
    """The covariance of images of noise is R Σ Rᵀ within sampling error; for linear methods.

    Remedy: return images of noise that follow from the same matrix as images of loads.

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
    demand(prepared, ratio < 1.5, f"has noise whose covariance is {ratio:.2f} sampling errors from R Σ Rᵀ")
    return Checked("noise propagation", f"{ratio:.2f} sampling errors of {draws} draws")


def check_noise_weighing(factory: Factory, prepared: PreparedReconstruction) -> Checked:
    """Noisy readings have less weight if the problem states their noise; runs use one matrix.

    Remedy: weight readings by ``problem.noise_variance``, or set ``weighs_noise = False``.

    By the propagated noise tr(R Σ Rᵀ) of a matrix prepared for those variances, against one for equal ones. A method
    that weights all readings equally states so (``weighs_noise = False``).
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
    demand(
        prepared,
        after < 0.9 * before,
        f"does not weigh readings by their noise: loud ones leave {after / before:.3g} of the noise of equal weights",
    )
    return Checked("noise weighing", f"loud readings leave {after / before:.2g} of the noise of equal weights")


def _image_with(prepared: PreparedReconstruction, masked: Mask, value: float) -> Array:
    """Image of a target from whole frames with a given value in masked readings."""
    problem = prepared.problem
    reference = np.where(masked, value, 0.0)
    reference[problem.used] = problem.reference
    frame = reference.copy()
    frame[problem.used] += signal(problem, PLACES[1], CONTRAST)
    return prepared.images(changes(frame[None], reference, problem, scale_of(reference, problem)))


def _mm(place: Array) -> str:
    return f"({place[0]:z.1f}, {place[1]:z.1f}) mm"
