"""What a calibration says of force, group ``force`` of its file: how precisely it is kept, and what is refused.

What is prepared again from the rest is kept in single precision, templates in steps of 2⁻²², whose last bits would
otherwise be half of the file: forces differ by less than 1e-6 of themselves, and templates that are prepared again on
the same computer are the same to the bit.
A file is read by people's robots, so that everything an index, a division or a square root rests on is looked at
before anything is worked out from it.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Final

import numpy as np

from cbsr_qa.domain import CalibrationError, kept_fields
from cbsr_qa.domain.results import Calibration, ForceModel, RelaxationKernel

#: Templates have the length one, but for rounding to single precision.
_UNIT: Final = 1e-3


def as_filed(model: ForceModel) -> ForceModel:
    """Return a model with the precision its file has, so that what is issued is what is read."""
    filed: dict[str, Any] = {}
    for field in kept_fields(ForceModel):
        values = getattr(model, field.name)
        if isinstance(values, np.ndarray) and values.dtype == np.float64:
            values = np.round(values / field.kept.step) * field.kept.step if field.kept.step else values
            values = values + 0.0
            filed[field.name] = values.astype(np.float32).astype(np.float64) if field.kept.single else values
    return replace(model, **filed)


def check_usable(calibration: Calibration) -> None:
    """Make sure that what a force model leans on can be worked with.

    Raises
    ------
    CalibrationError
        If merging, reference and used readings do not fit each other, or a slope, current or head is no number that
        could be divided by.
    """
    model, used = calibration.force, calibration.reconstruction.problem.used
    if model is None:
        return
    shape = calibration.sensor_type.pattern.shape
    if calibration.reference.shape != shape or used.shape != shape:
        raise CalibrationError(
            f"reference/voltages of {calibration.reference.shape} and reconstruction/used of {used.shape} are not"
            f" those of {shape[0]} drive and {shape[1]} measure pairs"
        )
    if model.merging.shape[1] != int(used.sum()):
        raise CalibrationError(f"force/merging is for {model.merging.shape[1]} readings, {int(used.sum())} are used")
    if not np.isfinite(calibration.reference[used]).all():
        raise CalibrationError("reference/voltages holds a used reading that is not a finite number")
    line, validity = calibration.against_stress, calibration.validity
    known = (line.slope.stderr, line.intercept.stderr, line.covariance, *(validity.force_N or ()))
    finite = (line.slope.value, line.intercept.value, validity.radius_mm, *(x for x in known if x is not None))
    if not np.isfinite(finite).all() or line.slope.value == 0:
        raise CalibrationError("quasi_static/against_stress or validity holds what no force can be worked out from")
    positive = (calibration.current_A, calibration.indenter.diameter_mm, calibration.indenter.squared_radius_mm2)
    if not all(np.isfinite(value) and value > 0 for value in positive):
        raise CalibrationError("reference/current or indenter is not a positive number")


def force_problems(model: ForceModel) -> Iterator[str]:
    """Say what is wrong with a model whose numbers have the sizes and shapes they are allowed to have."""
    there = model.node[model.node >= 0]
    if (model.node < -1).any() or not np.array_equal(np.sort(there), np.arange(len(model.templates))):
        yield f"force/node does not name each of {len(model.templates)} templates once, and −1 elsewhere"
    if not model.fits.any():
        yield "force/fits allows a head nowhere"
    xx, xy, yy = model.turning.T
    if not ((xx > 0) & (xx * yy - xy**2 > 0)).all():
        yield "force/turning is not positive definite somewhere: no place could be found there"
    if not model.lattice.spacing_mm > 0:
        yield f"force/lattice/spacing of {model.lattice.spacing_mm:g} mm is not positive"
    if not np.allclose(np.linalg.norm(model.templates, axis=1), 1, rtol=0, atol=_UNIT):
        yield "force/templates are not of the length one"
    if not (model.threshold > 0 and model.misfit > 0 and 0 <= model.stress_kPa[0] <= model.stress_kPa[1]):
        yield "force/threshold, force/misfit or force/stress is out of range"
    for name, kernel in (("loading", model.loading), ("unloading", model.unloading)):
        if kernel is not None and not _rises(kernel):
            yield f"force/{name} holds time constants that are not positive and rising, or no freedom"


def _rises(kernel: RelaxationKernel) -> bool:
    tau = kernel.time_constants_s
    return bool((tau > 0).all() and (np.diff(tau) > 0).all() and kernel.scatter_freedom > 0)
