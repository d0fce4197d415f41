"""A small sheet whose every step can be repeated in fifty digits, and the condition numbers of its readings."""

from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.mesh import Mesh
from cbsr_qa.domain.patterns import DrivePattern, adjacent_pattern
from cbsr_qa.forward.model import ForwardModel

Array = NDArray[np.float64]

ELECTRODES: Final = 8
RADIUS_MM: Final = 50.0
_RINGS: Final = 5
_SPOKES: Final = 2 * ELECTRODES


def small_mesh(radii_mm: Array | None = None) -> Mesh:
    """A disc with eight electrodes of one edge each on its rim, 81 nodes.

    Parameters
    ----------
    radii_mm : (5,) of the rings, rising; evenly spaced by default.
    """
    radii = RADIUS_MM * np.arange(1, _RINGS + 1) / _RINGS if radii_mm is None else radii_mm
    return ring_mesh(radii, _SPOKES, ELECTRODES, 1)


def ring_mesh(radii_mm: Array, spokes: int, electrodes: int, edges_each: int) -> Mesh:
    """A disc of rings of triangles, as many on each ring, with electrodes on its rim.

    Parameters
    ----------
    radii_mm : of the rings, rising. spokes : nodes on each. edges_each : of an electrode.
    """
    angle = 2 * np.pi * np.arange(spokes) / spokes
    around = np.stack([np.outer(radii_mm, np.cos(angle)), np.outer(radii_mm, np.sin(angle))], axis=-1).reshape(-1, 2)
    here = np.arange(spokes)
    there = (here + 1) % spokes
    elements = [np.column_stack([np.zeros(spokes, dtype=np.int64), 1 + here, 1 + there])]
    for ring in range(1, len(radii_mm)):
        inner, outer = 1 + (ring - 1) * spokes, 1 + ring * spokes
        elements.append(np.column_stack([inner + here, outer + here, outer + there]))
        elements.append(np.column_stack([inner + here, outer + there, inner + there]))
    rim = 1 + (len(radii_mm) - 1) * spokes
    first = spokes // electrodes * np.arange(electrodes)
    edges = tuple(rim + np.column_stack([k + np.arange(edges_each), k + np.arange(edges_each) + 1]) for k in first)
    return Mesh(np.vstack([[0.0, 0.0], around]), np.vstack(elements).astype(np.int64), edges)


@lru_cache(maxsize=1)
def small_model() -> ForwardModel:
    """Homogeneous, with ordinary contacts; made once per process."""
    mesh = small_mesh()
    return ForwardModel(mesh, adjacent_pattern(ELECTRODES), np.ones(len(mesh.elements)), np.full(ELECTRODES, 5.0))


def inclusion(contrast: float) -> Array:
    """Conductances (e,) of the small sheet with a round inclusion of half its radius."""
    away = np.hypot(*small_model().mesh.centroids_mm.T)
    return np.where(away < RADIUS_MM / 2, contrast, 1.0)


def islands(parted: float) -> Array:
    """Good conductors round the electrodes, parted by a poor one that all current has to pass."""
    x, y = small_model().mesh.centroids_mm.T
    turn = np.arctan2(y, x) / (2 * np.pi) * ELECTRODES % 1
    return np.where((turn < 0.5) & (np.hypot(x, y) > 30), 1.0, parted)


def scattered(decades: float, seed: int = 20261121) -> Array:
    """Conductances (e,) whose logarithms are scattered evenly over some decades."""
    random = np.random.default_rng(seed)
    values: Array = 10 ** random.uniform(-decades / 2, decades / 2, len(small_model().mesh.elements))
    return values


def relative_error(found: Array, exact: Array, pattern: DrivePattern) -> float:
    """‖V − V*‖/‖V*‖ over the readings that touch no driven electrode."""
    used = pattern.usable()
    return float(np.linalg.norm((found - exact)[used]) / np.linalg.norm(exact[used]))


def reading_condition(model: ForwardModel, before: Array | None = None) -> float:
    """Relative condition number of the readings for small relative changes of every conductance and contact.

    ‖Σ_e |∂V/∂γ_e| γ_e + Σ_l |∂V/∂z_l| z_l‖ / ‖V‖ (Skeel 1979): what one rounding of the data does at worst.

    Parameters
    ----------
    model : of the readings.
    before : (e,) where conductances are given as these and a change of them; both are data then.
    """
    used = model.pattern.usable()
    given = model.conductance if before is None else before + np.abs(model.conductance - before)
    felt = np.abs(model.jacobian()[used]) @ given
    felt += np.abs(model.contact_jacobian()[used]) @ model.contact_impedance
    return float(np.linalg.norm(felt) / np.linalg.norm(model.voltages()[used]))
