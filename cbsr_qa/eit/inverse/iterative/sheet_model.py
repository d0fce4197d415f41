"""Readings of a sheet with unknown conductance and contact impedances, and their derivatives.

Unknowns are logarithms, so that conductance and contact impedance stay positive: ln γ of each element of the image's
mesh and ln z of each electrode. The conductance of an element of the forward mesh is the mean over it of the image's.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import sparse

from cbsr_qa.domain import Array, Indices
from cbsr_qa.domain.results import ImagingProblem
from cbsr_qa.domain.sensor import SensorType
from cbsr_qa.eit.forward import ForwardModel
from cbsr_qa.eit.inverse.overlap import overlap_fractions
from cbsr_qa.eit.inverse.problem import NOMINAL_CONTACT_MM
from cbsr_qa.eit.inverse.readings import ReadingFold
from cbsr_qa.eit.mesh import sheet_mesh


@dataclass(frozen=True, slots=True, eq=False)
class SheetState:
    """Conductance and contacts of a sheet, in units in which the nominal sheet's conductance is one.

    Parameters
    ----------
    log_conductance : (e,) ln γ.
    log_contact : (electrodes,) ln z, z in mm.
    """

    log_conductance: Array
    log_contact: Array

    @property
    def unknowns(self) -> Array:
        """All of them, (e + electrodes,)."""
        return np.concatenate([self.log_conductance, self.log_contact])

    def moved(self, by: Array) -> "SheetState":
        """Return the state a step (e + electrodes,) further."""
        count = len(self.log_conductance)
        return SheetState(self.log_conductance + by[:count], self.log_contact + by[count:])


class SheetModel:
    """Folded readings of a problem as a function of the sheet's state.

    Parameters
    ----------
    problem : its mesh carries the conductance, its readings are computed.
    mesh_size : edge length of the forward mesh, of the sheet's radius; elements are of the second order.
    """

    def __init__(self, problem: ImagingProblem, mesh_size: float) -> None:
        sensor = problem.sensor_type
        self.fold = ReadingFold.of(problem)
        self._even = _even_model(sensor, mesh_size)
        self._share: sparse.csr_matrix = overlap_fractions(self._even.mesh, problem.mesh)
        drive, measure = np.argwhere(problem.used)[self.fold.first].T
        self._drive, self._measure = drive.astype(np.int64), measure.astype(np.int64)
        self.nominal = SheetState(
            np.zeros(len(problem.mesh.elements)), np.full(sensor.electrodes.count, np.log(NOMINAL_CONTACT_MM))
        )

    def at(self, state: SheetState) -> "SolvedSheet":
        """Solve for a state."""
        conductance = self._share @ np.exp(state.log_conductance)
        model = self._even.changed(conductance=conductance, contact_impedance=np.exp(state.log_contact))
        return SolvedSheet(state, model, self._share, self._drive, self._measure)


@dataclass(frozen=True, slots=True, eq=False)
class SolvedSheet:
    """One state of a sheet, factorised."""

    state: SheetState
    model: ForwardModel
    share: sparse.csr_matrix
    drive: Indices
    measure: Indices

    def readings(self) -> Array:
        """Folded readings (g,) at unit current [V/A]."""
        return self.model.voltages()[self.drive, self.measure]

    def jacobian(self) -> Array:
        """Change of the readings per change of ln γ and ln z, (g, e + electrodes)."""
        inside = self.model.jacobian_rows(self.drive, self.measure) @ self.share
        contacts = self.model.contact_jacobian()[self.drive, self.measure]
        return np.hstack([inside * np.exp(self.state.log_conductance), contacts * np.exp(self.state.log_contact)])


@lru_cache(maxsize=4)
def _even_model(sensor_type: SensorType, mesh_size: float) -> ForwardModel:
    mesh = sheet_mesh(sensor_type, size_mm=mesh_size * sensor_type.radius_mm, order=2)
    contact = np.full(sensor_type.electrodes.count, NOMINAL_CONTACT_MM)
    return ForwardModel(mesh, sensor_type.pattern, np.ones(len(mesh.elements)), contact, order=2)
