"""Hard cases of the forward model against Fourier series of a disc, and limits of its contacts."""

from collections.abc import Callable
from functools import lru_cache
from typing import Final

import numpy as np

from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.sensor.mesh import CircleArcs, Mesh
from cbsr_qa.domain.sensor.patterns import adjacent_pattern
from cbsr_qa.eit.forward.closed_forms import ConcentricSheet, arc_transfer_impedance
from cbsr_qa.eit.forward.model import ForwardModel
from cbsr_qa.studies.hard_cases.case import Answer, Area
from cbsr_qa.studies.hard_cases.sheets import reading_condition, relative_error, ring_mesh

AREA: Final = Area("forward model")
_ELECTRODES: Final = 8
_INSIDE: Final = 0.5  # the inclusion's radius over the sheet's: rings of the mesh lie on it
_MESHES: Final = (1, 2)  # steps between electrodes' ends, and rings: the second mesh halves the first one's edges
_CONTACT: Final = 0.2  # z γ over the radius
_CONVERGES: Final = 3.0  # of the error is left at most where edges are halved: second order but for a logarithm


@lru_cache(maxsize=2)
def _disc(fineness: int) -> ForwardModel:
    """Unit disc of second order, its rim and the inclusion's outline true arcs; made once per process."""
    spokes, rings = 32 * fineness, 8 * fineness
    mesh = ring_mesh(np.arange(1, rings + 1) / rings, spokes, _ELECTRODES, spokes // (4 * _ELECTRODES) or 1)
    around = np.arange(spokes)
    arcs = []
    for ring in (rings // 2, rings):
        first = 1 + (ring - 1) * spokes
        edges = np.column_stack([first + around, first + (around + 1) % spokes]).astype(np.int64)
        arcs.append(CircleArcs(edges, (0.0, 0.0), ring / rings))
    bent = Mesh(mesh.nodes_mm, mesh.elements, mesh.electrode_edges, tuple(arcs))
    pattern, count = adjacent_pattern(_ELECTRODES), len(mesh.elements)
    return ForwardModel(bent, pattern, np.ones(count), np.full(_ELECTRODES, _CONTACT), order=2)


def _angles(model: ForwardModel) -> tuple[Array, float]:
    """Middles of the electrodes, and half their width [rad]."""
    ends = [
        np.unwrap(np.arctan2(*model.mesh.nodes_mm[edges].reshape(-1, 2).T[::-1]))
        for edges in model.mesh.electrode_edges
    ]
    middles = np.array([(end.min() + end.max()) / 2 for end in ends])
    return middles, float(np.ptp(ends[0])) / 2


def _against_series(
    exact_sheet: ConcentricSheet, model_of: Callable[[ForwardModel], ForwardModel], contact: float, modes: int
) -> Answer:
    """Readings against a Fourier series, on a mesh whose edges are half those of another.

    Parameters
    ----------
    contact : z γ over the radius. modes : of a contact's current.
    """
    errors = []
    for fineness in _MESHES:
        model = model_of(_disc(fineness))
        exact = arc_transfer_impedance(exact_sheet, *_angles(model), contact, modes=modes, harmonics=20_000)
        errors.append(relative_error(model.voltages(), model.readings(exact), model.pattern))
    coarse, fine = errors
    note = f"the bound is the mesh's: a third of the {coarse:.1e} that a mesh of twice the edge length leaves"
    return Answer(fine, coarse / _CONVERGES, reading_condition(model), note=note)


def _with_inclusion(contrast: float) -> Answer:
    def model_of(disc: ForwardModel) -> ForwardModel:
        is_inside = np.hypot(*disc.mesh.centroids_mm.T) < _INSIDE
        return disc.with_values(conductance=np.where(is_inside, contrast, 1.0))

    return _against_series(ConcentricSheet(1.0, 1.0, _INSIDE, contrast), model_of, _CONTACT, 12)


_SERIES: Final = "Fourier series of the disc with Legendre polynomials on its electrodes"


@AREA.against(_SERIES)
def disc_with_inclusion_of_1e8() -> Answer:
    """A round load that conducts a hundred million times better: next to a short in the middle of the sheet."""
    return _with_inclusion(1e8)


@AREA.against(_SERIES)
def disc_with_inclusion_of_1e_8() -> Answer:
    """A round load that conducts a hundred millionth: next to a hole in the middle of the sheet."""
    return _with_inclusion(1e-8)


@AREA.against("Fourier series of the gap model")
def contacts_next_to_open_on_a_disc() -> Answer:
    """Contacts ten million times poorer than the sheet, against the limit in which they let current in evenly."""

    def model_of(disc: ForwardModel) -> ForwardModel:
        return disc.with_values(contact_impedance=np.full(_ELECTRODES, 1e7))

    return _against_series(ConcentricSheet(1.0, 1.0), model_of, 0.0, 1)
