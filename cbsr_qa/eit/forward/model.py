"""Complete electrode model of a sheet: factorised once, solved for every drive.

∇·(γ∇u) = 0, u + z_l γ ∂u/∂n = U_l on electrode l, ∫ γ ∂u/∂n = I_l, no flux elsewhere, ΣI = ΣU = 0
(Somersalo, Cheney & Isaacson 1992), in finite elements of first or second order (Vauhkonen et al. 1999). γ is *sheet*
conductance, so that contact impedance is per length of an electrode's outline.
"""

from functools import cached_property

import numpy as np

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array, Indices, real_numbers
from cbsr_qa.domain.sensor.mesh import Mesh
from cbsr_qa.domain.sensor.patterns import DrivePattern
from cbsr_qa.eit.forward.closed_forms import project_to_ground
from cbsr_qa.eit.forward.elements import FiniteElements, edge_contacts, point_contacts
from cbsr_qa.eit.forward.prepared import PreparedSheet
from cbsr_qa.eit.forward.value_range import check_range, check_values


class ForwardModel:
    """Voltages and sensitivities of one sheet. Prepared on construction, then only solved.

    Parameters
    ----------
    mesh : e elements, with electrode edges.
    pattern : drive and measure pairs.
    conductance : (e,) sheet conductance γ [S], positive; or (e, q, 2, 2), positive definite, by direction and
        integration point (1 for the first order, 3 for the second).
    contact_impedance : (electrodes,) z [Ω·mm], positive.
    order : order of the elements, 1 or 2.
    prepared : prepared sheet of another model on the same mesh, in place of ``order``.

    Raises
    ------
    NumericsError
        If the mesh is in pieces or has electrodes without edges, a value is not a positive finite number or out of
        range (:mod:`cbsr_qa.eit.forward.value_range`), or ``prepared`` belongs to another mesh.
    """

    def __init__(
        self,
        mesh: Mesh,
        pattern: DrivePattern,
        conductance: Array,
        contact_impedance: Array,
        *,
        order: int = 1,
        prepared: PreparedSheet | None = None,
    ) -> None:
        if prepared is None:
            elements = FiniteElements(mesh, order)
            prepared = PreparedSheet(elements, edge_contacts(elements))
        elif prepared.elements.mesh is not mesh:
            raise NumericsError("the sheet was prepared for another mesh", remedy="prepare the model for this mesh")
        self.mesh = mesh
        self.pattern = pattern
        self.prepared = prepared
        self.elements = prepared.elements
        #: ∫ ∇φ_i·∇φ_j over each element, (e, k, k)
        self.stiffness = prepared.elements.stiffness
        self.conductance = real_numbers(conductance, "conductances").copy()
        self.contact_impedance = real_numbers(contact_impedance, "contact impedances").copy()
        self._check()
        self._factors = prepared.factorise(self.conductance, self.contact_impedance)

    def with_values(
        self, *, conductance: Array | None = None, contact_impedance: Array | None = None
    ) -> "ForwardModel":
        """Return the same sheet with other values; mesh-dependent parts are reused."""
        return ForwardModel(
            self.mesh,
            self.pattern,
            self.conductance if conductance is None else conductance,
            self.contact_impedance if contact_impedance is None else contact_impedance,
            prepared=self.prepared,
        )

    def with_change_on(
        self, elements: Indices, change: Array, contact_impedance: Array | None = None
    ) -> "ForwardModel":
        """Return the same sheet with other conductances on some elements, factorised again.

        Parameters
        ----------
        elements : (m,) int64; changes of an element named twice add up.
        change : (m,), or (m, q, 2, 2) as of :meth:`Cover.change <cbsr_qa.eit.forward.coverage.Cover.change>` [S].
        contact_impedance : (electrodes,) z in place of the model's [Ω·mm].
        """
        self.check_elements(elements)
        conductance, change = _alike(self.conductance.copy(), change, len(self.elements.shapes.points))
        np.add.at(conductance, elements, change)
        return self.with_values(conductance=conductance, contact_impedance=contact_impedance)

    def check_elements(self, elements: Indices) -> None:
        """Refuse numbers (m,) that are not elements of the mesh; NumericsError names the range."""
        count = len(self.mesh.elements)
        if elements.size and not 0 <= elements.min() <= elements.max() < count:
            raise NumericsError(
                f"a changed element is not one of 0 to {count - 1}", remedy="count the mesh's elements from 0"
            )

    def conductance_after_change(self, elements: Indices, change: Array) -> Array:
        """Conductance of some elements, each named once, after a change: (m,) or (m, q, 2, 2) [S]."""
        conductance, change = _alike(self.conductance[elements], change, len(self.elements.shapes.points))
        return conductance + change

    def element_matrices(self, elements: Indices) -> Array:
        """Stiffness of some elements with their conductance: (m,) int64 to (m, k, k) [S]."""
        conductance = self.conductance[elements]
        if conductance.ndim > 1:
            return self.elements.directional_stiffness(elements, conductance)
        return conductance[:, None, None] * self.stiffness[elements]

    def solve(self, load: Array) -> Array:
        """Potentials (n, k) [V] of the finite elements' nodes for currents (n, k) [A] into them.

        Columns that do not sum to zero shift the whole sheet by a constant.
        """
        return self._factors.solve(load, refine=self._far_apart)

    @cached_property
    def electrode_fields(self) -> Array:
        """Potentials for a unit current into each electrode, returned evenly through all.

        (n, electrodes) float64 [V/A], up to a constant in each column.
        """
        return self._fields_at(np.arange(self.elements.count))

    @cached_property
    def transfer_impedance(self) -> Array:
        """Z of U = Z·I for ΣI = 0, with ΣU = 0: (electrodes, electrodes) [Ω]."""
        return project_to_ground(self._sheet_impedance + np.diag(self._own_impedance))

    def voltages(self) -> Array:
        """Readings per unit current: (drives, measures) [V/A]."""
        return self.readings(self._sheet_impedance) + self.readings(np.diag(self._own_impedance))

    def readings(self, transfer_impedance: Array) -> Array:
        """Turn a transfer impedance (electrodes, electrodes) into readings (drives, measures)."""
        driven, measured = self._pairs
        return (transfer_impedance @ driven).T @ measured

    def jacobian(self) -> Array:
        """Change of every reading per change of every element's conductance: (drives, measures, e) [V/A per S].

        ∂V_kl/∂γ_e = −∫_e ∇u_k·∇u_l with u_k the field of the drive and u_l of a unit current through the measured
        pair (Lionheart 2004).
        """
        driven_fields, measured_fields = self._pair_fields
        jacobian = np.empty((*self.pattern.shape, len(self.mesh.elements)))
        for rows, field in zip(jacobian, driven_fields, strict=True):
            np.einsum("ie,mie->me", field, measured_fields, out=rows)
        return np.negative(jacobian, out=jacobian)

    def jacobian_rows(self, drive: Indices, measure: Indices) -> Array:
        """Rows (m, e) of :meth:`jacobian` for given drive and measure pairs (m,) [V/A per S]."""
        driven_fields, measured_fields = self._pair_fields
        rows = np.empty((len(drive), len(self.mesh.elements)))
        for row, k, m in zip(rows, drive, measure, strict=True):
            np.einsum("ie,ie->e", driven_fields[k], measured_fields[m], out=row)
        return np.negative(rows, out=rows)

    def contact_jacobian(self) -> Array:
        """Change of readings per change of contact impedances: (drives, measures, electrodes) [V/A per Ω·mm].

        ∂V_kl/∂z_n = ∫ j_k j_l ds over electrode n, with j = I/|E| + (ū − u)/z the current density under it.
        """
        contacts = self.prepared.contacts
        electrodes = len(contacts.nodes)
        slopes = np.zeros((*self.pattern.shape, electrodes))
        for number, (nodes, mass) in enumerate(zip(contacts.nodes, contacts.masses, strict=True)):
            fields = self._fields_against(nodes, nodes[0])  # nearly equal under good contacts
            impedance = fields.T @ mass @ fields / self.contact_impedance[number] ** 2
            impedance[number, number] += 1 / contacts.lengths_mm[number]
            slopes[..., number] = self.readings(impedance)
        return slopes

    @cached_property
    def _pairs(self) -> tuple[Array, Array]:
        """Currents of the drive pairs and weights of the measure pairs, each (electrodes, pairs)."""
        return self.pattern.drive_currents(), self.pattern.measure_matrix()

    @cached_property
    def _pair_fields(self) -> tuple[Array, Array]:
        """Gradients, times the root of their areas, for drive and measure pairs: (pairs, 2 q, e)."""
        elements = self.elements
        root = np.sqrt(elements.weights_mm2)[..., None, None] * elements.gradients  # (e, q, k, 2)
        count, q, k, _ = root.shape
        gradient = root.transpose(0, 1, 3, 2).reshape(count, 2 * q, k)
        nodal = self._fields_against(elements.cells, elements.cells[:, :1])  # nearly equal in good conductors

        def compute_fields(pairs: Array) -> Array:
            return np.array((gradient @ (nodal @ pairs)).transpose(2, 1, 0), dtype=np.float64, order="C")

        driven, measured = self._pairs
        drive = compute_fields(driven)
        return drive, drive if self.pattern.drive == self.pattern.measure else compute_fields(measured)

    @property
    def _own_impedance(self) -> Array:
        """Contribution of each electrode's contact to its own potential, (electrodes,) [Ω]."""
        return self.contact_impedance / self.prepared.contacts.lengths_mm

    @cached_property
    def _sheet_impedance(self) -> Array:
        """Mean potentials under the electrodes per electrode current, up to a constant in each column [Ω]."""
        contacts = self.prepared.contacts
        touched = np.concatenate(contacts.nodes)
        return contacts.means[touched].T @ self._fields_at(touched)

    def _fields_at(self, nodes: Indices) -> Array:
        fields = np.empty((len(nodes), len(self.contact_impedance)))
        fields[:, 1:] = self._ordered[0][self.prepared.place[nodes]]
        fields[:, 0] = -fields[:, 1:] @ np.ones(fields.shape[1] - 1)  # together they drive nothing
        return fields

    def _fields_against(self, nodes: Indices, others: Indices) -> Array:
        """Differences of :attr:`electrode_fields` between nodes, accurate relative to their size: (…, electrodes)."""
        place = self.prepared.place
        rows, other_rows = place[nodes], place[others]
        fields, error = self._ordered
        differences = fields[rows] - fields[other_rows]
        if error is not None:
            differences += error[rows] - error[other_rows]
        return np.concatenate([-differences.sum(axis=-1, keepdims=True), differences], axis=-1)

    @cached_property
    def _ordered(self) -> tuple[Array, Array | None]:
        """Fields (n, electrodes − 1) of all electrodes but the first, by elimination, and their rounding error."""
        drives = self.prepared.ordered_drives
        return (
            self._factors.refine_ordered(drives) if self._far_apart else (self._factors.solve_ordered(drives), None)
        )

    def _check(self) -> None:
        electrodes, count = self.pattern.electrode_count, len(self.mesh.elements)
        if len(self.prepared.contacts.nodes) != electrodes:
            raise NumericsError(
                f"the mesh carries {len(self.prepared.contacts.nodes)} electrodes with edges,"
                f" the pattern needs {electrodes}",
                remedy="use a pattern of the mesh's electrodes",
            )
        directional = (len(self.elements.shapes.points), 2, 2) if self.conductance.ndim > 1 else ()
        check_values("conductance", self.conductance, (count, *directional))
        check_values("contact impedance", self.contact_impedance, (electrodes,))
        lengths_mm = self.prepared.contacts.lengths_mm
        self._far_apart = check_range(self.conductance, self.contact_impedance, lengths_mm, self.prepared.beside)


def point_model(
    mesh: Mesh, nodes: Indices, pattern: DrivePattern, conductance: Array, *, order: int = 1
) -> ForwardModel:
    """Model with point electrodes, the limit of narrow ones: currents go in at nodes (electrodes,), each once.

    Readings that touch a driven electrode grow without bound as the mesh is refined; the others converge. The model's
    contact impedance is one everywhere and has no effect.

    Raises
    ------
    NumericsError
        As for :class:`ForwardModel`, or if nodes are not in the mesh or repeat.
    """
    elements = FiniteElements(mesh, order)
    prepared = PreparedSheet(elements, point_contacts(elements, nodes))
    return ForwardModel(mesh, pattern, conductance, np.ones(len(nodes)), prepared=prepared)


def _alike(before: Array, change: Array, points: int) -> tuple[Array, Array]:
    """Conductances, both as numbers or both as matrices (…, q, 2, 2)."""
    if np.ndim(before) == np.ndim(change):
        return before, change
    first, second = (
        part if np.ndim(part) > 1 else np.multiply.outer(part, np.tile(np.eye(2), (points, 1, 1)))
        for part in (before, change)
    )
    return first, second
