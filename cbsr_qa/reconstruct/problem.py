"""The linearised problem of a sensor type: a fine mesh for the voltages, a coarse one for the image."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.footprints import RoundFootprint
from cbsr_qa.domain.mesh import Mesh
from cbsr_qa.domain.reconstruction import ImagingProblem
from cbsr_qa.domain.sensor import SensorType
from cbsr_qa.forward.coverage import cover
from cbsr_qa.forward.local import LocalUpdate
from cbsr_qa.forward.meshing import image_mesh, sheet_mesh
from cbsr_qa.forward.model import ForwardModel
from cbsr_qa.reconstruct.sensitivity import image_jacobian

Array = NDArray[np.float64]

#: Nominal contact impedance times sheet conductance [mm]. Readings that touch no driven electrode hardly feel it.
NOMINAL_CONTACT_MM = 0.5

_FORWARD_SIZE = 0.1  # edge length of the forward mesh far from electrodes, of the radius (5 mm on a 100 mm disc)
_FEWEST_READINGS = 16


def imaging_problem(
    sensor_type: SensorType,
    *,
    used: NDArray[np.bool_] | None = None,
    noise_variance: Array | None = None,
    image_size_mm: float = 3.0,
) -> ImagingProblem:
    """Linearise a sensor type around its unloaded homogeneous sheet.

    Parameters
    ----------
    used : (drives, measures) bool, readings to image from; by default those that touch no driven electrode. Bad
        channels are left out here, never set to zero.
    noise_variance : (drives, measures) or (m,) float64, variances of the readings in any common unit; None for equal
        noise.
    image_size_mm : edge length of the image's elements [mm].

    Returns
    -------
    ImagingProblem
        Prepared once per process, sensor type and image size; further masks only choose rows.

    Raises
    ------
    NumericsError
        If the mask has another shape, fewer than 16 readings are left, or a variance is not a positive finite number.
    """
    nominal = _nominal(sensor_type, float(image_size_mm))
    used = sensor_type.pattern.usable() if used is None else np.array(used, dtype=np.bool_)
    if used.shape != sensor_type.pattern.shape:
        raise NumericsError(f"a mask of {used.shape} readings does not fit frames of {sensor_type.pattern.shape}")
    count = int(used.sum())
    if count < _FEWEST_READINGS:
        raise NumericsError(
            f"only {count} readings are left to image from; at least {_FEWEST_READINGS} are needed",
            remedy="mend the channels that were masked",
        )
    variance = None if noise_variance is None else _variance_of(np.asarray(noise_variance, dtype=np.float64), used)
    whole = sensor_type.pattern.usable()
    full = _rows(sensor_type, nominal, whole, None, None)
    if variance is None and np.array_equal(used, whole):
        return full
    return _rows(sensor_type, nominal, used, variance, full)


def _rows(
    sensor_type: SensorType,
    nominal: "_Nominal",
    used: NDArray[np.bool_],
    variance: Array | None,
    full: ImagingProblem | None,
) -> ImagingProblem:
    return ImagingProblem(
        sensor_type, nominal.mesh, nominal.jacobian[used], nominal.reference[used], used, variance, full
    )


def nominal_model(sensor_type: SensorType) -> LocalUpdate:
    """Homogeneous sheet at unit conductance, ready for local changes; made once per process and sensor type."""
    return _nominal_model(sensor_type)


def target_signal(problem: ImagingProblem, *, x_mm: float, y_mm: float, radius_mm: float, contrast: float) -> Array:
    """Simulate the used readings' changes for a disc of other conductance, on the forward mesh.

    Parameters
    ----------
    contrast : relative conductance change Δγ/γ₀, above −1.

    Returns
    -------
    (m,) float64, scaled as the problem's Jacobian [V/(A·Ω)].

    Raises
    ------
    NumericsError
        If the disc does not touch the sheet, or the contrast leaves no conductance.
    """
    local = nominal_model(problem.sensor_type)
    model = local.model
    covered = cover(model.elements, RoundFootprint(x_mm, y_mm, radius_mm))
    if not covered.elements.size:
        raise NumericsError(f"a target of radius {radius_mm} mm at ({x_mm}, {y_mm}) mm does not touch the sheet")
    change = local.voltages(covered.elements, covered.change(model.conductance, contrast)) - model.voltages()
    signal: Array = change[problem.used]
    return signal


@dataclass(frozen=True, slots=True, eq=False)
class _Nominal:
    mesh: Mesh
    jacobian: Array  # (drives, measures, e)
    reference: Array  # (drives, measures)


@lru_cache(maxsize=8)
def _nominal_model(sensor_type: SensorType) -> LocalUpdate:
    mesh = sheet_mesh(sensor_type, size_mm=_FORWARD_SIZE * sensor_type.radius_mm, order=2)
    contact = np.full(sensor_type.electrodes.count, NOMINAL_CONTACT_MM)
    return LocalUpdate(ForwardModel(mesh, sensor_type.pattern, np.ones(len(mesh.elements)), contact, order=2))


@lru_cache(maxsize=8)
def _nominal(sensor_type: SensorType, image_size_mm: float) -> _Nominal:
    model = _nominal_model(sensor_type).model
    mesh = image_mesh(sensor_type, size_mm=image_size_mm)
    group, sign = sensor_type.pattern.reading_groups()
    _, first, number = np.unique(group, return_index=True, return_inverse=True)
    drive, measure = np.unravel_index(first, group.shape)
    distinct = image_jacobian(model, mesh, drive, measure)
    number = number.reshape(group.shape)
    jacobian = distinct[number] * (sign * sign.ravel()[first][number])[..., None]
    reference = model.voltages()
    jacobian.flags.writeable = reference.flags.writeable = False  # shared by everybody who asks
    return _Nominal(mesh, jacobian, reference)


def _variance_of(variance: Array, used: NDArray[np.bool_]) -> Array:
    count = int(used.sum())
    variance = variance[used] if variance.shape == used.shape else variance
    if variance.shape != (count,) or not (np.isfinite(variance) & (variance > 0)).all():
        raise NumericsError(
            f"noise variances of shape {variance.shape} are not one positive finite number"
            f" for each of {count} readings"
        )
    return variance
