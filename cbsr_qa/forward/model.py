"""Complete electrode model of a sheet: factorised once, solved for every drive.

∇·(γ∇u) = 0, u + z_l γ ∂u/∂n = U_l on electrode l, ∫ γ ∂u/∂n = I_l, no flux elsewhere, ΣI = ΣU = 0
(Somersalo, Cheney & Isaacson 1992), in linear finite elements (Vauhkonen et al. 1999). γ is *sheet* conductance, so
that contact impedance is per length of an electrode's outline.
"""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import SuperLU, splu

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.mesh import Mesh
from cbsr_qa.domain.patterns import DrivePattern
from cbsr_qa.forward.assembly import check_connected, contact_lengths, electrode_system, gradients, local_stiffness

Array = NDArray[np.float64]


class ForwardModel:
    """Voltages and sensitivities of one sheet. Prepared on construction, then only solved.

    Parameters
    ----------
    mesh : n nodes, e elements, with electrode edges.
    pattern : drive and measure pairs.
    conductance : (e,) sheet conductance γ [S], positive.
    contact_impedance : (electrodes,) z [Ω·mm], positive.

    Raises
    ------
    NumericsError
        If the mesh is in pieces or has electrodes without edges, or a conductance or contact impedance is not a
        positive finite number.
    """

    def __init__(self, mesh: Mesh, pattern: DrivePattern, conductance: Array, contact_impedance: Array) -> None:
        _check(mesh, pattern, conductance, contact_impedance)
        self.mesh = mesh
        self.pattern = pattern
        self.conductance = np.array(conductance, dtype=np.float64)
        self.contact_impedance = np.array(contact_impedance, dtype=np.float64)
        self.stiffness = local_stiffness(mesh)
        system = electrode_system(mesh, self.conductance, self.contact_impedance, stiffness=self.stiffness)
        self._factors: SuperLU = splu(
            system, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )

    def solve(self, load: Array) -> Array:
        """Solve for the nodes' potentials caused by currents into nodes.

        Parameters
        ----------
        load : (n, k) [A]; columns that do not sum to zero raise the whole sheet by some constant.

        Returns
        -------
        (n, k) [V].
        """
        potentials: Array = self._factors.solve(np.asfortranarray(load))
        return potentials

    @cached_property
    def electrode_fields(self) -> Array:
        """Potentials for a unit current into each electrode and out of all alike.

        Returns
        -------
        (n, electrodes) float64 [V/A], up to a constant in each column.
        """
        density = self._means - self._means.mean(axis=1, keepdims=True)
        return self.solve(density)

    @cached_property
    def transfer_impedance(self) -> Array:
        """Electrode potentials per electrode current Z.

        Returns
        -------
        (electrodes, electrodes) float64 [Ω], U = Z·I for ΣI = 0, with ΣU = 0.
        """
        lengths = contact_lengths(self.mesh).sum(axis=0)
        impedance: Array = self._means.T @ self.electrode_fields + np.diag(self.contact_impedance / lengths)
        impedance -= impedance.mean(axis=0)
        impedance -= impedance.mean(axis=1, keepdims=True)
        return impedance

    @cached_property
    def _means(self) -> Array:
        """Weights of the mean over each electrode, (n, electrodes)."""
        lengths = contact_lengths(self.mesh)
        means: Array = lengths / lengths.sum(axis=0)
        return means

    def voltages(self) -> Array:
        """Readings per unit current: (drives, measures) [V/A]."""
        return self.readings(self.transfer_impedance)

    def readings(self, transfer_impedance: Array) -> Array:
        """Turn a transfer impedance (electrodes, electrodes) into readings (drives, measures)."""
        potentials = transfer_impedance @ self.pattern.drive_currents()
        readings: Array = potentials.T @ self.pattern.measure_matrix()
        return readings

    def jacobian(self) -> Array:
        """Change of every reading per change of every element's conductance.

        ∂V_kl/∂γ_e = −∫_e ∇u_k·∇u_l with u_k the field of the drive and u_l of a unit current through the measured
        pair (Lionheart 2004); the adjoint field needs no further factorisation because the system is symmetric.

        Returns
        -------
        (drives, measures, e) [V/A per S].
        """
        drive, measure = self._element_fields
        areas = self.mesh.areas_mm2
        jacobian: Array = drive[:, None, 0] * measure[None, :, 0]
        jacobian += drive[:, None, 1] * measure[None, :, 1]
        jacobian *= -areas
        return jacobian

    @cached_property
    def _element_fields(self) -> tuple[Array, Array]:
        """Gradients per element for drive and measure pairs, each (pairs, 2, e)."""
        nodal = self.electrode_fields[self.mesh.elements]  # (e, 3, electrodes)
        gradient = gradients(self.mesh).transpose(0, 2, 1) @ nodal  # (e, 2, electrodes)
        pairs = (self.pattern.drive_currents(), self.pattern.measure_matrix())
        drive, measure = (np.ascontiguousarray((gradient @ pair).transpose(2, 1, 0)) for pair in pairs)
        return drive, measure


def _check(mesh: Mesh, pattern: DrivePattern, conductance: Array, contact_impedance: Array) -> None:
    bare = [k for k, edges in enumerate(mesh.electrode_edges) if not len(edges)]
    if bare or len(mesh.electrode_edges) != pattern.electrode_count:
        raise NumericsError(
            f"the mesh carries {len(mesh.electrode_edges) - len(bare)} electrodes with edges,"
            f" the pattern needs {pattern.electrode_count}",
            remedy=f"give edges to electrode {bare[0]}" if bare else "",
        )
    check_connected(mesh)
    for name, values, count in (
        ("conductance", conductance, len(mesh.elements)),
        ("contact impedance", contact_impedance, pattern.electrode_count),
    ):
        _check_positive(name, np.asarray(values), count)


def _check_positive(name: str, values: Array, count: int) -> None:
    if values.shape != (count,):
        raise NumericsError(f"{name} has shape {values.shape}; one value for each of {count} is needed")
    wrong = np.flatnonzero(~(np.isfinite(values) & (values > 0)))
    if wrong.size:
        raise NumericsError(
            f"{name} {wrong[0]} is {values[wrong[0]]} (one of {wrong.size} such); it must be a positive finite number"
        )
