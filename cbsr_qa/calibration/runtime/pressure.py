"""Frames as maps of stress: the image corrected by the sensor's own response, in kilopascal (paper section 2.4)."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

from cbsr_qa.calibration.force.inverse import LEFT_OUT, NO_FORCE
from cbsr_qa.calibration.runtime.calibration import Calibration
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.numbers import Array, Indices
from cbsr_qa.domain.sensor.mesh import Mesh

#: Spacing, in nodes of the map, of the places where the image's gain is computed: 5 mm on the 100 mm disc.
_STRIDE = 4
#: Least gain over the usual one.
_MIN_RELATIVE_GAIN = 0.2


class PressureMap:
    """Stress by element of the image.

    σ = (Δρ/ρ̄₀ − β_σ)/α_σ in every element (paper Eq 1), with ρ̄₀ by place: c g S, with S the map of the response, g
    the image under the calibrated head there per contrast, by the forward model, and c, near one, the mean over the
    calibrated locations of their ρ̄₀ over g S. The paper has one ρ̄₀ for the whole sheet, whose images are twice as
    strong at 30 mm as in the centre. The image's blur remains: a head's force is not the integral of this map but
    that of :meth:`Calibration.force`.

    CalibrationError if no location of the calibration has a ρ̄₀.
    """

    def __init__(self, calibration: Calibration) -> None:
        issued = calibration.issued
        places = [(p.x_mm, p.y_mm, p.value) for p in issued.baseline if p.value is not None]
        if not places:
            raise CalibrationError(
                f"no location of calibration {issued.calibration} relates images to loads",
                remedy="calibrate again; the report says why no location has a baseline conductance",
            )
        self._calibration = calibration
        self.mesh: Mesh = issued.reconstruction.problem.mesh
        locations = np.array(places)
        homogeneous = _Homogeneous(calibration)
        scale = float(np.mean(locations[:, 2] / homogeneous(locations[:, :2])))
        self.baseline_conductance: Array = scale * homogeneous(self.mesh.centroids_mm)
        self._line = issued.against_stress

    def stress_kPa(self, frames: ArrayLike, *, current_A: float | None = None) -> Array:
        """Stress (n, elements) in each frame (n, drives, measures) [V]; NaN in frames that are not whole."""
        changes, flags = self._calibration.changes(frames, current_A=current_A)
        issued = self._calibration.issued
        images = changes @ issued.reconstruction.matrix.T / issued.scale
        stress = self._stress(issued.response.sign * images)
        stress[flags & (NO_FORCE | LEFT_OUT) != 0] = np.nan
        return stress

    @property
    def floor_kPa(self) -> Array:
        """Stress (elements,) equivalent to the noise floor of the images."""
        return np.abs(self._stress(np.full(len(self.baseline_conductance), self._calibration.issued.noise_floor)))

    def _stress(self, change: Array) -> Array:
        slope, intercept = self._line.slope.value, self._line.intercept.value
        # A negative response has a negative line; images are signed to be positive.
        sign = np.sign(slope)
        stress: Array = (change / self.baseline_conductance - sign * intercept) / (sign * slope)
        return stress


class _Homogeneous:
    """Image under a head of nominal contrast, by place: gain of the image times the map."""

    def __init__(self, calibration: Calibration) -> None:
        model = calibration.model
        nodes_mm = model.lattice.places_mm()[model.node.ravel() >= 0]
        rows, columns = np.nonzero(model.node >= 0)
        fitting = np.flatnonzero(model.fits & (rows % _STRIDE == 0) & (columns % _STRIDE == 0))
        # Every node of a coarse lattice is used.
        if np.linalg.matrix_rank(nodes_mm[fitting] - nodes_mm[fitting].mean(axis=0)) < 2:
            fitting = np.flatnonzero(model.fits)
        places = nodes_mm[fitting]
        values = _compute_gains(calibration, fitting, places) * np.exp(model.log_response[fitting])
        self._between = LinearNDInterpolator(places, values)
        self._nearest = NearestNDInterpolator(places, values)

    def __call__(self, places_mm: Array) -> Array:
        """At places (n, 2); where no head fits, at the nearest place where one does."""
        interpolated: Array = self._between(places_mm)
        return np.where(np.isfinite(interpolated), interpolated, self._nearest(places_mm))


def _compute_gains(calibration: Calibration, nodes: Indices, places_mm: Array) -> Array:
    """Mean image (n,) under the head per contrast, from the templates of nodes (n,) at places (n, 2)."""
    issued, model = calibration.issued, calibration.model
    rows = model.templates[nodes] * np.exp(model.log_size[nodes])[:, None]
    # Reciprocal readings were merged into one row: the smallest changes with these rows are the model's.
    changes = rows @ np.linalg.pinv(model.merging).T / issued.scale
    mesh = issued.reconstruction.problem.mesh
    images = changes @ issued.reconstruction.matrix.T
    gains = np.empty(len(nodes))
    for number, (x_mm, y_mm) in enumerate(places_mm.tolist()):
        head_weight = issued.indenter.footprint_at(x_mm, y_mm).contains(mesh.centroids_mm) * mesh.areas_mm2
        gains[number] = float(images[number] @ head_weight / head_weight.sum()) if head_weight.any() else np.nan
    typical = float(np.nanmedian(gains))
    # An image that is almost zero under a head cannot be corrected there.
    return np.where(gains > _MIN_RELATIVE_GAIN * typical, gains, _MIN_RELATIVE_GAIN * typical)
