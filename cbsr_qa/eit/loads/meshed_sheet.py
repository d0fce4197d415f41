"""Fields of a meshed sheet of uniform conductance, expanded about interior points from boundary values.

Inside an even sheet every field is harmonic, and Green's identity with the pole p = (z − c)⁻ᵐ gives its coefficients
from the edge: 2πm A_m = ∮ (p ∂u/∂n − u ∂p/∂n) ds, smooth in the place c and of twice the elements' order of accuracy.
The response of edge and electrodes to a pole is b_pᵀ K⁻¹ b_g + ⟨p, g⟩, symmetric, with b_p the weak form's load of a
pole, K the sheet's matrix and ⟨p, g⟩ an integral over the edge.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array, Indices
from cbsr_qa.eit.forward.model import ForwardModel
from cbsr_qa.eit.loads.round_load import Expansion

Complex = NDArray[np.complex128]

_AT_ONCE = 8  # places whose poles are stored along the whole edge
_SOLVED_AT_ONCE = 8  # the solver is disproportionately slower for more


class MeshedSheet:
    """A sheet of any outline with any electrodes that have a contact impedance.

    Parameters
    ----------
    model : model with unit conductance everywhere; of second order, unless the mesh is fine.
    radius_mm : size of the sheet.

    Raises
    ------
    NumericsError
        If the conductance is not one everywhere, or electrodes are points.
    """

    def __init__(self, model: ForwardModel, radius_mm: float) -> None:
        if model.conductance.ndim > 1 or not np.allclose(model.conductance, 1.0, rtol=1e-12):
            raise NumericsError("fields can be expanded only on a sheet of unit conductance")
        if not np.isfinite(model.prepared.contacts.lengths_mm).all():
            raise NumericsError("point electrodes have no edge to evaluate a field on")
        self.model = model
        self.radius_mm = radius_mm
        edges = model.mesh.outline
        nodes = model.elements.along(edges)
        shapes = model.elements.shapes
        corners = model.elements.points_mm[nodes] @ np.array([1, 1j])  # (b, k)
        tangent = corners @ shapes.edge_slopes.T
        #: points along the edge, and the outward normal there, (g,)
        self._points: Complex = (corners @ shapes.edge_values.T).ravel()
        self._normal: Complex = (-1j * tangent / np.abs(tangent)).ravel()
        self._lengths: Array = (np.abs(tangent) * shapes.edge_weights).ravel()
        self._nodes, place = np.unique(nodes, return_inverse=True)
        self._spread = _spread(place.reshape(nodes.shape), shapes.edge_values, self._lengths)
        owner = np.repeat(_owners(model, edges), len(shapes.edge_weights))
        self._contact: Indices = np.flatnonzero(owner >= 0)
        self._owner = owner[self._contact]
        lengths = self._lengths[self._contact]
        total = np.bincount(self._owner, lengths)
        shape = (len(total), len(self._points))
        self._means = sparse.csr_matrix((lengths / total[self._owner], (self._owner, self._contact)), shape=shape)
        #: one over the contact impedance at those points, (g,)
        self._admittance: Array = 1 / model.contact_impedance[self._owner]

    @property
    def extent_mm(self) -> tuple[float, float, float, float]:
        x, y = self._points.real, self._points.imag
        return float(x.min()), float(x.max()), float(y.min()), float(y.max())

    def clearance_mm(self, place_mm: Array) -> Array:
        """Radius of the largest disc about each place (n, 2) that touches neither edge nor electrode: (n,) [mm].

        Negative outside, and inside of a pin.
        """
        centre = np.asarray(place_mm, dtype=np.float64) @ np.array([1, 1j])
        away = self._points - centre[:, None]
        steps = 1j * self._normal * self._lengths
        turns = (steps / away).imag.sum(axis=1) / (2 * np.pi)
        clear: Array = np.where(turns > 0.5, 1, -1) * np.abs(away).min(axis=1)
        return clear

    def transfer_impedance(self) -> Array:
        """Electrode potentials per electrode current, (electrodes, electrodes) [Ω], with ΣI = ΣU = 0."""
        return self.model.transfer_impedance

    def fields(self, place_mm: Array, reach_mm: Array, orders: int) -> Array:
        """Fields of unit currents about places, as in :class:`~cbsr_qa.eit.loads.round_load.Expansion`."""
        poles = [self._expand_about(*part, orders) for part in _parts(place_mm, reach_mm)]
        return np.concatenate([part.fields(self._fields) for part in poles])

    def expansion(self, place_mm: Array, reach_mm: Array, orders: int) -> Expansion:
        """Expand about places.

        Parameters
        ----------
        place_mm : (n, 2), further from edge and electrodes than the length of the edge's elements.
        reach_mm : (n,) unit of distances from each place; positive.
        orders : M.
        """
        fields, response = [], []
        for part in _parts(place_mm, reach_mm):
            about = self._expand_about(*part, orders)
            fields.append(about.fields(self._fields))
            response.append(about.response(self._inverse))
        return Expansion(orders, np.concatenate(fields), np.concatenate(response))

    def _expand_about(self, centre: Complex, reach: Array, orders: int) -> "_Poles":
        pole, flux = self._poles(centre, reach, orders)
        mean = np.stack([self._means @ values for values in pole])  # (n, electrodes, 2M)
        contact_drop = pole[:, self._contact] - mean[:, self._owner]
        contact_flux = contact_drop * self._admittance[:, None]
        own_product = np.swapaxes(pole * self._lengths[:, None], 1, 2) @ flux
        own_product += np.swapaxes(contact_drop * self._lengths[self._contact, None], 1, 2) @ contact_flux
        flux[:, self._contact] += contact_flux
        load = -np.stack([self._spread @ values for values in flux])  # (n, nodes, 2M)
        weight = 2 * np.pi * np.tile(np.arange(1, orders + 1), 2)[:, None]
        return _Poles(mean, load, own_product, weight)

    def _poles(self, centre: Complex, reach: Array, orders: int) -> tuple[Array, Array]:
        """Poles (reach/(z − c))^m along the edge and their outward slopes, real and imaginary parts: (n, g, 2M)."""
        ratio = reach[:, None] / (self._points - centre[:, None])
        power = np.empty((*ratio.shape, orders + 1), dtype=np.complex128)
        power[..., 0] = ratio
        for order in range(1, orders + 1):
            np.multiply(power[..., order - 1], ratio, out=power[..., order])
        slope = power[..., 1:] * (self._normal / reach[:, None])[..., None] * -np.arange(1, orders + 1)
        poles = power[..., :-1]
        return np.concatenate([poles.real, poles.imag], axis=2), np.concatenate([slope.real, slope.imag], axis=2)

    @cached_property
    def _fields(self) -> Array:
        """Potentials of the electrodes' fields on the edge, (nodes, electrodes)."""
        return self.model.electrode_fields[self._nodes]

    @cached_property
    def _inverse(self) -> Array:
        """K⁻¹ between the nodes on the edge, for loads that sum to zero: (nodes, nodes)."""
        inverse = np.empty((len(self._nodes),) * 2)
        for begin in range(0, len(self._nodes), _SOLVED_AT_ONCE):
            nodes = self._nodes[begin : begin + _SOLVED_AT_ONCE]
            load = np.zeros((self.model.elements.count, len(nodes)))
            load[nodes, np.arange(len(nodes))] = 1
            inverse[:, begin : begin + len(nodes)] = self.model.solve(load)[self._nodes]
        return (inverse + inverse.T) / 2


@dataclass(frozen=True, slots=True, eq=False)
class _Poles:
    """Effect of poles at n places on the edge.

    Parameters
    ----------
    mean : (n, electrodes, 2M) mean under each electrode.
    load : (n, nodes, 2M) current into the nodes of the edge, to cancel their current through it.
    own : (n, 2M, 2M) product of the poles among themselves.
    weight : (2M, 1) 2πm.
    """

    mean: Array
    load: Array
    own: Array
    weight: NDArray[np.floating[Any]]

    def fields(self, edge: Array) -> Array:
        return (np.swapaxes(self.mean, 1, 2) + np.swapaxes(self.load, 1, 2) @ edge) / self.weight

    def response(self, inverse: Array) -> Array:
        count, nodes, columns = self.load.shape
        flat = np.swapaxes(self.load, 0, 1).reshape(nodes, -1)
        answer = np.swapaxes((inverse @ flat).reshape(nodes, count, columns), 0, 1)
        return (np.swapaxes(self.load, 1, 2) @ answer - self.own) / self.weight


def _parts(place_mm: Array, reach_mm: Array) -> Iterator[tuple[Complex, Array]]:
    centre = np.asarray(place_mm, dtype=np.float64) @ np.array([1, 1j])
    for first in range(0, len(centre), _AT_ONCE):
        yield centre[first : first + _AT_ONCE], np.asarray(reach_mm)[first : first + _AT_ONCE]


def _spread(place: Indices, values: Array, lengths: Array) -> sparse.csr_matrix:
    """Matrix (nodes, b·g) from a density along edges with nodes (b, k), shape functions (g, k), to nodal loads."""
    count, points = len(place), len(values)
    entries = (lengths.reshape(count, points, 1) * values).ravel()
    rows = np.repeat(place[:, None], points, axis=1).ravel()
    columns = np.repeat(np.arange(count * points), place.shape[1])
    return sparse.csr_matrix((entries, (rows, columns)), shape=(int(place.max()) + 1, count * points))


def _owners(model: ForwardModel, edges: Indices) -> Indices:
    """Electrode of each edge (b, 2); −1 without one."""
    count = len(model.mesh.nodes_mm)
    keys = np.sort(edges, axis=1) @ np.array([count, 1])
    owner = np.full(len(edges), -1, dtype=np.int64)
    for number, electrode_edges in enumerate(model.mesh.electrode_edges):
        owner[np.isin(keys, np.sort(electrode_edges, axis=1) @ np.array([count, 1]))] = number
    return owner
