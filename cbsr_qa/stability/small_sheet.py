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
    """A disc of rings of triangles with eight electrodes of one edge each on its rim, 81 nodes.

    Parameters
    ----------
    radii_mm : (5,) of the rings, rising; evenly spaced by default.
    """
    radii = RADIUS_MM * np.arange(1, _RINGS + 1) / _RINGS if radii_mm is None else radii_mm
    angle = 2 * np.pi * np.arange(_SPOKES) / _SPOKES
    around = np.stack([np.outer(radii, np.cos(angle)), np.outer(radii, np.sin(angle))], axis=-1).reshape(-1, 2)
    here = np.arange(_SPOKES)
    there = (here + 1) % _SPOKES
    elements = [np.column_stack([np.zeros(_SPOKES, dtype=np.int64), 1 + here, 1 + there])]
    for ring in range(1, _RINGS):
        inner, outer = 1 + (ring - 1) * _SPOKES, 1 + ring * _SPOKES
        elements.append(np.column_stack([inner + here, outer + here, outer + there]))
        elements.append(np.column_stack([inner + here, outer + there, inner + there]))
    rim = 1 + (_RINGS - 1) * _SPOKES
    edges = tuple(np.array([[rim + 2 * k, rim + 2 * k + 1]]) for k in range(ELECTRODES))
    return Mesh(np.vstack([[0.0, 0.0], around]), np.vstack(elements).astype(np.int64), edges)


@lru_cache(maxsize=1)
def small_model() -> ForwardModel:
    """Homogeneous, with ordinary contacts; made once per process."""
    mesh = small_mesh()
    return ForwardModel(mesh, adjacent_pattern(ELECTRODES), np.ones(len(mesh.elements)), np.full(ELECTRODES, 5.0))


def relative_error(found: Array, exact: Array, pattern: DrivePattern) -> float:
    """‖V − V*‖/‖V*‖ over the readings that touch no driven electrode."""
    used = pattern.usable()
    return float(np.linalg.norm((found - exact)[used]) / np.linalg.norm(exact[used]))


def reading_condition(model: ForwardModel) -> float:
    """Relative condition number of the readings for small relative changes of every conductance and contact.

    ‖Σ_e |∂V/∂γ_e| γ_e + Σ_l |∂V/∂z_l| z_l‖ / ‖V‖ (Skeel 1979): what one rounding of the data does at worst.
    """
    used = model.pattern.usable()
    felt = np.abs(model.jacobian()[used]) @ model.conductance
    felt += np.abs(model.contact_jacobian()[used]) @ model.contact_impedance
    return float(np.linalg.norm(felt) / np.linalg.norm(model.voltages()[used]))
