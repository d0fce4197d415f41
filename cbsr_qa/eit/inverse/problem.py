"""The linearised problem of a sensor type: a fine mesh for voltages, a coarse one for the image.

∂V_kl/∂γ over an image element is −∫∇u_k·∇u_l over it. The element is cut along the field's mesh, and the product is
taken at the centroid of each piece: exact for fields of the first order, of second order in the size of the pieces
for those of the second.
"""

from functools import lru_cache
from typing import Final

import numpy as np
from scipy import sparse

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.geometry.footprints import RoundFootprint
from cbsr_qa.domain.imaging import ImagingProblem
from cbsr_qa.domain.numbers import Array, Indices, Mask, real_numbers
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.domain.sensor.patterns import FEWEST_INDEPENDENT, DrivePattern
from cbsr_qa.domain.sensor.sensor_type import SensorType
from cbsr_qa.eit.forward.coverage import cover
from cbsr_qa.eit.forward.model import ForwardModel
from cbsr_qa.eit.inverse.overlap import Pieces, overlap_pieces
from cbsr_qa.eit.loads.local import LocalUpdate
from cbsr_qa.eit.mesh.sheet import image_mesh, sheet_mesh


def image_jacobian(model: ForwardModel, mesh: Mesh, drive: Indices, measure: Indices) -> Array:
    """Change of readings per change of the conductance of a mesh's elements: (m, e) float64 [V/A per S].

    Parameters
    ----------
    mesh : mesh of the image, e elements, over the model's sheet.
    drive, measure : (m,) numbers of the readings' drive and measure pairs.
    """
    pieces = overlap_pieces(model.mesh, mesh)
    fields = _fields_at(model, pieces)
    driven_fields, measured_fields = (
        fields @ pairs for pairs in (model.pattern.drive_currents(), model.pattern.measure_matrix())
    )
    driven_fields, measured_fields = (
        np.ascontiguousarray(pair_fields.transpose(2, 1, 0)) for pair_fields in (driven_fields, measured_fields)
    )
    products = np.empty((len(drive), len(pieces.areas_mm2)))
    for row, k, m in zip(products, drive, measure, strict=True):
        np.einsum("xp,xp->p", driven_fields[k], measured_fields[m], out=row)
    count = len(pieces.areas_mm2)
    gather = sparse.csr_matrix((-pieces.areas_mm2, (pieces.coarse, np.arange(count))), (len(mesh.elements), count))
    return np.ascontiguousarray((gather @ products.T).T)


def _fields_at(model: ForwardModel, pieces: Pieces) -> Array:
    """Gradients of the electrodes' fields at the pieces' centroids, (p, 2, electrodes)."""
    elements, points = model.elements, model.elements.shapes.points
    nodal = model.electrode_fields[elements.cells]
    gradients = np.einsum("eqkx,ekl->eqxl", elements.gradients, nodal, optimize=True)
    if len(points) == 1:
        constant: Array = gradients[pieces.fine, 0]
        return constant
    corners = model.mesh.corners_mm[pieces.fine]
    edge_vectors = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2)
    inner = np.linalg.solve(edge_vectors, (pieces.centroids_mm - corners[:, 0])[..., None])[..., 0]
    barycentric = np.column_stack([1 - inner.sum(axis=1), inner])
    weights = barycentric @ np.linalg.inv(points)  # the gradient is linear, and known at three points
    fields: Array = np.einsum("pq,pqxl->pxl", weights, gradients[pieces.fine], optimize=True)
    return fields


#: Nominal contact impedance times sheet conductance [mm]. Readings that touch no driven electrode hardly depend on
#: it.
NOMINAL_CONTACT_MM = 0.5

_FORWARD_SIZE = 0.1  # edge length of the forward mesh far from electrodes, of the radius (5 mm on a 100 mm disc)
_MOST_UNEQUAL: Final = 1e12  # largest over smallest noise variance; beyond, rounding dominates


def imaging_problem(
    sensor_type: SensorType,
    *,
    used: Mask | None = None,
    noise_variance: Array | None = None,
    image_size_mm: float = 3.0,
    sample: Array | None = None,
    measured: Array | None = None,
) -> ImagingProblem:
    """Linearise a sensor type around its unloaded homogeneous sheet.

    Prepared once per process, sensor type and image size; further masks only choose rows.

    Parameters
    ----------
    used : (drives, measures) bool, readings to image from; by default those that touch no driven electrode. Any
        electrodes may be missing while :data:`FEWEST_INDEPENDENT` independent readings are left; for the cost
        see :func:`masking_effect`.
    noise_variance : (drives, measures) or (m,) float64, variances of the readings in any common unit; None for equal
        noise. Kept relative to their harmonic mean. The largest used one is at most 1e12 times the smallest.
    image_size_mm : edge length of the image's elements [mm].
    sample, measured : (k, drives, measures) or (k, m), and without k, as of :class:`ImagingProblem`; scaled as its
        reference.

    Raises
    ------
    NumericsError
        If the mask has another shape, too few independent readings are left, a variance is not a
        positive finite number or too far from the others, or a sample or measured frame does not fit or is not
        finite.
    """
    is_usable = sensor_type.pattern.usable()
    used = is_usable if used is None else np.array(used, dtype=np.bool_)
    _check_used(sensor_type.pattern, used)
    if not (used & is_usable).any():  # readings across driven electrodes are all there is
        is_usable = used
    prepared = is_usable | used
    mesh, reference = nominal_image_mesh(sensor_type, float(image_size_mm)), _nominal_reference(sensor_type)
    jacobian = _nominal_jacobian(sensor_type, float(image_size_mm), prepared.tobytes())
    full = ImagingProblem(sensor_type, mesh, jacobian[is_usable[prepared]], reference[is_usable], is_usable)
    if noise_variance is None and sample is None and measured is None and np.array_equal(used, is_usable):
        return full
    return ImagingProblem(
        sensor_type,
        mesh,
        jacobian[used[prepared]],
        reference[used],
        used,
        None if noise_variance is None else _relative_variance(real_numbers(noise_variance, "noise variances"), used),
        full,
        None if sample is None else _readings("sample", real_numbers(sample, "readings of a sample"), used, 2),
        None
        if measured is None
        else _readings("measured frame", real_numbers(measured, "readings of a measured frame"), used, 1),
    )


def find_masked_electrodes(pattern: DrivePattern, used: Mask) -> tuple[int, ...]:
    """Electrodes with usable readings, (drives, measures) bool, none of which is used."""
    is_usable, is_left = (_electrodes_involved(pattern, readings) for readings in (pattern.usable(), used))
    return tuple(int(electrode) for electrode in np.flatnonzero(is_usable & ~is_left))


@lru_cache(maxsize=8)
def make_uniform_model(sensor_type: SensorType, mesh_size: float) -> ForwardModel:
    """Homogeneous sheet of unit conductance with nominal contacts, in elements of the second order.

    ``mesh_size``: edge length far from electrodes, of the sheet's radius.
    """
    mesh = sheet_mesh(sensor_type, size_mm=mesh_size * sensor_type.radius_mm, order=2)
    contact = np.full(sensor_type.electrodes.count, NOMINAL_CONTACT_MM)
    return ForwardModel(mesh, sensor_type.pattern, np.ones(len(mesh.elements)), contact, order=2)


def nominal_model(sensor_type: SensorType) -> ForwardModel:
    """Homogeneous sheet at unit conductance; made once per process and sensor type."""
    return make_uniform_model(sensor_type, _FORWARD_SIZE)


def target_signal(problem: ImagingProblem, *, x_mm: float, y_mm: float, radius_mm: float, contrast: float) -> Array:
    """Simulated changes (m,) of the used readings [V/(A·Ω)] for a disc of another conductance, on the forward mesh.

    Identical to the last bit, independent of earlier computations.

    Parameters
    ----------
    contrast : relative conductance change Δγ/γ₀, above −1.

    Raises
    ------
    NumericsError
        If the disc does not touch the sheet, or the contrast leaves no conductance.
    """
    return _disc_change(problem.sensor_type, x_mm, y_mm, radius_mm, contrast)[problem.used]


@lru_cache(maxsize=64)
def _disc_change(sensor_type: SensorType, x_mm: float, y_mm: float, radius_mm: float, contrast: float) -> Array:
    model = nominal_model(sensor_type)
    covered = cover(model.elements, RoundFootprint(x_mm, y_mm, radius_mm))
    if not covered.elements.size:
        raise NumericsError(f"a target of radius {radius_mm} mm at ({x_mm}, {y_mm}) mm does not touch the sheet")
    loaded = LocalUpdate(model).voltages(covered.elements, covered.change(model.conductance, contrast))
    return loaded - model.voltages()


@lru_cache(maxsize=8)
def nominal_image_mesh(sensor_type: SensorType, image_size_mm: float) -> Mesh:
    """Mesh of the images of a sensor type; made once per process, sensor type and size."""
    return image_mesh(sensor_type, size_mm=image_size_mm)


@lru_cache(maxsize=8)
def _nominal_reference(sensor_type: SensorType) -> Array:
    """Readings (drives, measures) of the unloaded sheet."""
    reference = nominal_model(sensor_type).voltages()
    reference.flags.writeable = False  # shared by all callers
    return reference


@lru_cache(maxsize=8)
def _nominal_jacobian(sensor_type: SensorType, image_size_mm: float, readings: bytes) -> Array:
    """Jacobian (m, e) of some readings, given as the bytes of their mask (drives, measures).

    Reciprocal readings are computed once. Readings that are not asked for cost nothing: an ohmmeter reads only the
    diagonal of its pattern.
    """
    mask = np.frombuffer(readings, dtype=np.bool_).reshape(sensor_type.pattern.shape)
    group, sign = sensor_type.pattern.reading_groups()
    _, first_readings = np.unique(group, return_index=True)
    asked, number = np.unique(group[mask], return_inverse=True)
    drive, measure = np.unravel_index(first_readings[asked], group.shape)
    mesh = nominal_image_mesh(sensor_type, image_size_mm)
    distinct_rows = image_jacobian(nominal_model(sensor_type), mesh, drive, measure)
    jacobian: Array = distinct_rows[number] * (sign[mask] * sign.ravel()[first_readings[asked]][number])[:, None]
    jacobian.flags.writeable = False  # shared by all callers
    return jacobian


def _check_used(pattern: DrivePattern, used: Mask) -> None:
    if used.shape != pattern.shape:
        raise NumericsError(
            f"mask of shape {used.shape} does not match frames of shape {pattern.shape}",
            remedy="give one boolean for each drive and measure pair",
        )
    _check_number(pattern, used)


def _check_number(pattern: DrivePattern, used: Mask) -> None:
    """Refuse too few readings; the message names the cause, which is the pattern or a mask."""
    independent = pattern.too_few_readings(used)
    if independent is None:
        return
    left_out = int((pattern.usable() & ~used).sum())
    if left_out:
        raise NumericsError(
            f"only {independent} independent readings remain with {left_out} masked; at least"
            f" {FEWEST_INDEPENDENT} are needed to image",
            remedy="repair the masked channels",
        )
    raise NumericsError(
        f"the pattern gives {independent} independent readings; at least {FEWEST_INDEPENDENT} are needed to image",
        remedy="drive or measure at further pairs of electrodes",
    )


def _electrodes_involved(pattern: DrivePattern, readings: Mask) -> Mask:
    """Electrodes that some readings involve, (electrodes,)."""
    driven, measured = pattern.drive_currents() != 0, pattern.measure_matrix() != 0
    touched: Mask = driven[:, readings.any(axis=1)].any(axis=1)
    touched |= measured[:, readings.any(axis=0)].any(axis=1)
    return touched


def _relative_variance(variance: Array, used: Mask) -> Array:
    count = int(used.sum())
    variance = variance[used] if variance.shape == used.shape else variance
    if variance.shape != (count,):
        raise NumericsError(
            f"noise variances have shape {variance.shape}; there are {count} used readings",
            remedy=f"give {count} of them, or {used.shape} by drive and measure pair",
        )
    bad = np.flatnonzero(~(np.isfinite(variance) & (variance > 0)))
    if bad.size:
        raise NumericsError(
            f"the noise variance of {reading_name(used, bad[0])} is {variance[bad[0]]} (one of {bad.size} such)"
            "; it must be a positive finite number",
            remedy="leave its channel out (`used`), or give it a variance near the others'",
        )
    _check_spread(variance, used)
    with np.errstate(over="ignore"):
        mean = (1 / variance).mean()
    if not np.isfinite(mean) or mean < np.finfo(np.float64).tiny:
        extreme = int(variance.argmax() if np.isfinite(mean) else variance.argmin())
        raise NumericsError(
            f"the noise variance of {reading_name(used, extreme)} is {variance[extreme]:g}; its reciprocal is beyond"
            " the range of numbers",
            remedy="give variances in a larger or smaller unit; only their ratios matter",
        )
    relative: Array = variance * mean
    return relative


def _check_spread(variance: Array, used: Mask) -> None:
    """Refuse a variance so far from the others that the image depends on it alone, or its share is only rounding."""
    least, largest = int(variance.argmin()), int(variance.argmax())
    if variance[largest] / _MOST_UNEQUAL <= variance[least]:
        return
    size = np.log(variance)
    far = largest if size[largest] + size[least] > 2 * np.median(size) else least
    other = least if far == largest else largest
    raise NumericsError(
        f"the noise variance of {reading_name(used, far)} is {variance[far]:g}, that of {reading_name(used, other)}"
        f" {variance[other]:g}; the largest is at most {_MOST_UNEQUAL:g} times the smallest",
        remedy="leave its channel out (`used`), or give it a variance near the others'",
    )


def reading_name(used: Mask, reading: int) -> str:
    """Name of a used reading, counted among these, in a message."""
    drive, measure = np.argwhere(used)[reading]
    return f"reading (drive {drive}, measure {measure})"


def _readings(what: str, values: Array, used: Mask, axes: int) -> Array:
    """Used readings of frames, or of one, which may be given as such already."""
    count = int(used.sum())
    if values.shape[-2:] == used.shape and values.ndim == axes + 1:
        values = values[..., used]
    if values.ndim != axes or values.shape[-1] != count or not values.size:
        raise NumericsError(
            f"a {what} of shape {values.shape} does not match {count} used readings",
            remedy=f"give {'frames' if axes > 1 else 'one frame'} of {count} readings, or of {used.shape}",
        )
    if not np.isfinite(values).all():
        raise NumericsError(f"a {what} holds a reading that is not a finite number", remedy="leave its channel out")
    return values
