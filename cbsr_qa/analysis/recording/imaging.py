"""Readings of a recording as changes of the unit model, and the patterns of loads in them.

Unless a sensor type is named, a recording is imaged on a nominal unit disc, with lengths in units of its radius.
Readings become changes of the unit model in one of two ways:

- volts, and magnitudes of tanks: each channel against its own reference value, (V/V_ref − 1) · model. This cancels
channel gains, the missing sign of magnitudes, and the faster decay of a deep tank's far readings.
- counts with an unknown offset: (V − V_ref)/s, with s the slope of the reference frame over the model's (negative if
the board reverses the polarity). The board's common offset is projected out later.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.imaging import ImagingProblem
from cbsr_qa.domain.numbers import Array, Mask
from cbsr_qa.domain.sensor.electrodes import ElectrodeKind, ElectrodeLayout, Electrodes
from cbsr_qa.domain.sensor.patterns import adjacent_pattern
from cbsr_qa.domain.sensor.sensor_type import Response, SensorType
from cbsr_qa.eit.inverse.problem import imaging_problem, nominal_image_mesh

_NOMINAL_RADIUS_MM = 50.0
_ARC = 0.1  # length of a nominal electrode, of the radius
_IMAGE_SIZE = 0.06  # of the radius: 3 mm on a 100 mm disc
#: A load is modelled as a bump of this width (one standard deviation, of the radius): the head and the blur.
_BUMP = 0.11
#: Places further out (nearer to the edge of another sheet than the rest of the radius) are too close to electrodes:
#: contact changes there look like loads.
_OUTERMOST = 0.9
#: Least correlation of the reference frame with the model for counts to be imaged.
_LEAST_CORRELATION = 0.5
#: Cosine between reference and model from which one scale suffices for all channels.
_CLOSE_COSINE = 0.9


@dataclass(frozen=True, slots=True, eq=False)
class Sheet:
    """Model used to image a recording.

    Parameters
    ----------
    problem : linearised model of the used readings.
    places : (p, 2) float64, candidate places in units of the radius.
    patterns : (m, p) float64, what a small load at each place does to the used readings.
    """

    problem: ImagingProblem
    places: Array
    patterns: Array

    @property
    def radius_mm(self) -> float:
        """Radius of the sheet; of the nominal disc without a sensor type."""
        return self.problem.sensor_type.radius_mm

    @property
    def layout(self) -> Electrodes:
        return self.problem.sensor_type.electrodes


def nominal_disc(layout: Electrodes | None, electrode_count: int) -> SensorType:
    """Disc with arc electrodes on its edge, for recordings without a sensor type.

    Parameters
    ----------
    layout : numbering documented by the recording's format; electrode 0 on +x, counterclockwise, if it documents none
        or the electrodes are not on a ring.
    """
    ring = layout if isinstance(layout, ElectrodeLayout) else None
    first_deg = 0.0 if ring is None else ring.first_angle_deg
    turning = True if ring is None else ring.counterclockwise
    electrodes = ElectrodeLayout(
        electrode_count, ElectrodeKind.ARC, _NOMINAL_RADIUS_MM, _ARC * _NOMINAL_RADIUS_MM, first_deg, turning
    )
    return SensorType(
        "nominal disc", _NOMINAL_RADIUS_MM, 1.0, electrodes, adjacent_pattern(electrode_count), Response.AUTO
    )


def problem_for(sensor_type: SensorType, used: Mask) -> ImagingProblem:
    """Prepare the unit model of the used readings; NumericsError if too few are left."""
    return imaging_problem(sensor_type, used=used, image_size_mm=_IMAGE_SIZE * sensor_type.radius_mm)


def sheet_for(sensor_type: SensorType, used: Mask) -> Sheet:
    """Prepare the patterns of the used readings; NumericsError if too few are left."""
    problem = problem_for(sensor_type, used)
    inner, bumps = _bumps(sensor_type)
    patterns: Array = problem.jacobian @ bumps
    return Sheet(problem, problem.mesh.centroids_mm[inner] / sensor_type.radius_mm, patterns)


@lru_cache(maxsize=4)
def _bumps(sensor_type: SensorType) -> tuple[NDArray[np.int64], Array]:
    mesh = nominal_image_mesh(sensor_type, _IMAGE_SIZE * sensor_type.radius_mm)
    places = mesh.centroids_mm / sensor_type.radius_mm
    if sensor_type.polygon is None:
        well_inside = np.hypot(*places.T) <= _OUTERMOST
    else:
        clearance = sensor_type.polygon.clearance_mm(mesh.centroids_mm) / sensor_type.radius_mm
        well_inside = clearance >= min(1 - _OUTERMOST, float(clearance.max()) / 2)
    inner = _thin_places(places, np.flatnonzero(well_inside).astype(np.int64))
    distance = ((places[:, None] - places[None, inner]) ** 2).sum(axis=2)
    bumps = np.exp(-distance / (2 * _BUMP**2)) * mesh.areas_mm2[:, None]
    return inner, bumps / bumps.sum(axis=0)


def _thin_places(places: Array, candidates: NDArray[np.int64]) -> NDArray[np.int64]:
    """Thin out places to half a bump's distance; closer ones add nothing."""
    kept_candidates: list[int] = []
    for candidate in candidates[np.argsort(np.hypot(*places[candidates].T), kind="stable")]:
        distances = np.hypot(*(places[kept_candidates] - places[candidate]).T)
        if not kept_candidates or distances.min() >= _BUMP / 2:
            kept_candidates.append(int(candidate))
    return np.array(kept_candidates, dtype=np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class UnitModel:
    """Conversion of a recording's readings to changes of the unit model.

    Parameters
    ----------
    reference : (m,) used readings of the unloaded sheet, in the recording's unit.
    gain : (m,) unit-model volts per recorded unit.
    nuisance : (m,) pattern without information on places: a common offset of counts, or a common gain of volts.
    """

    reference: Array
    gain: Array
    nuisance: Array

    def changes(self, readings: Array) -> Array:
        """Changes of used readings (n, m) relative to the reference, in the unit model's volts."""
        return (readings - self.reference) * self.gain


def unit_model(reference: Array, problem: ImagingProblem, *, offset: bool) -> UnitModel:
    """Fit a recording to the unit model.

    Parameters
    ----------
    reference : (m,) used readings of the unloaded sheet.
    offset : whether they include an unknown offset.
    """
    model = problem.reference
    if not offset:
        if (reference == 0).any():
            raise NumericsError("a reference reading is zero", remedy="leave its channel out")
        return UnitModel(reference, model / reference, model)
    centred = model - model.mean()
    slope = float(centred @ (reference - reference.mean()) / (centred @ centred))
    spread = float(np.linalg.norm(reference - reference.mean()))
    correlation = abs(slope) * float(np.linalg.norm(centred)) / spread if spread else 0.0
    if correlation < _LEAST_CORRELATION:
        raise NumericsError(
            f"the readings do not match a sheet driven and measured at adjacent pairs"
            f" (correlation with the model {correlation:.2f}, at least {_LEAST_CORRELATION} is needed)",
            remedy="check the electrode order, and whether readings are clipped",
        )
    return UnitModel(reference, np.full_like(reference, 1 / slope), np.ones_like(reference))


#: Largest change of a table of changes, as a share of the largest reading of the model: their true scale is unknown.
_ASSUMED_CHANGE = 0.1


def difference_model(changes: Array, problem: ImagingProblem) -> UnitModel:
    """Bring changes (n, m) of unknown scale to that of the unit model, by the largest of them."""
    largest = float(np.abs(changes).max(initial=0.0))
    scale = _ASSUMED_CHANGE * float(np.abs(problem.reference).max()) / largest if largest else 1.0
    return UnitModel(np.zeros(changes.shape[1]), np.full(changes.shape[1], scale), problem.reference)


def plain_model(reference: Array, problem: ImagingProblem) -> UnitModel | None:
    """Fit a recording without an offset to the unit model with one scale for all channels.

    Returns
    -------
    UnitModel, or None if the reference, given the model's signs, does not follow the model closely.
    """
    model = problem.reference
    signed = np.abs(reference) * np.sign(model)
    cosine = float(signed @ model / (np.linalg.norm(signed) * np.linalg.norm(model)))
    if cosine < _CLOSE_COSINE:
        return None
    scale = float(signed @ model / (model @ model))
    return UnitModel(reference, np.sign(model) * np.sign(reference) / scale, signed)


def usable_volts(reference: Array, used: Mask, noise: Array | None) -> Mask:
    """Used readings whose reference value clearly exceeds its noise, so that relative changes are meaningful.

    Parameters
    ----------
    reference : (drives, measures). noise : same shape, or None without an estimate.
    """
    size = np.abs(reference)
    least = 1e-3 * float(np.median(size[used])) if used.any() else 0.0
    floor = np.maximum(5 * noise, least) if noise is not None else np.full_like(size, least)
    return used & (size > floor)
