"""What a user would pick instead: pyEIT 1.2.4, prepared here once for all parts."""

import contextlib
import io
import warnings
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.reference_solutions import point_transfer_impedance
from cbsr_qa.eit.forward.closed_forms import ConcentricSheet
from cbsr_qa.eit.mesh.pyeit import import_pyeit_protocol

Array = NDArray[np.float64]

#: pyEIT's edge lengths for its meshes of 686, 2821 and 7901 elements.
SIZES = (0.1, 0.05, 0.03)
_OPTIONS: dict[str, Any] = {"p": 0.5, "lamb": 0.01, "method": "kotre", "perm": 1, "jac_normalized": False}


@dataclass(frozen=True, eq=False)
class Peer:
    """pyEIT on one of its own disc meshes, 16 point electrodes, adjacent drive and measurement."""

    mesh: Any
    protocol: Any

    @property
    def elements(self) -> int:
        return len(self.mesh.element)

    def forward(self) -> Any:
        """A forward solver, not yet run; ``solve_eit()`` assembles, factorises and solves 16 drives."""
        from pyeit.eit.fem import EITForward

        return EITForward(self.mesh, self.protocol)

    def jac(self) -> Any:
        """One-step Gauss–Newton, set up: forward fields, Jacobian, inverse."""
        from pyeit.eit.jac import JAC

        solver = JAC(self.mesh, self.protocol)
        solver.setup(**_OPTIONS)
        return solver

    def greit(self) -> Any:
        """GREIT, set up, on a raster of 32 × 32."""
        from pyeit.eit.greit import GREIT

        solver = GREIT(self.mesh, self.protocol)
        solver.setup(p=0.5, lamb=0.01, perm=1, jac_normalized=False)
        return solver

    def readings(self, conductance: Array | None = None) -> Array:
        """Its 208 readings, for a conductance per element or a homogeneous disc."""
        return np.asarray(self.forward().solve_eit(perm=1.0 if conductance is None else conductance))

    def exact_readings(self, sheet: ConcentricSheet) -> Array:
        """Readings of point electrodes where its are, without a mesh."""
        nodes = np.asarray(self.mesh.node)[np.asarray(self.mesh.el_pos)]
        impedance = point_transfer_impedance(sheet, np.arctan2(nodes[:, 1], nodes[:, 0]))
        read = import_pyeit_protocol(self.protocol, len(nodes))
        currents, weights = read.pattern.drive_currents(), read.pattern.measure_matrix()
        return read.list_readings((impedance @ currents).T @ weights)

    def voltage_error(self) -> float:
        """Relative error of the homogeneous disc's readings against the exact point solution."""
        expected = self.exact_readings(ConcentricSheet(1.0, 1.0))
        return float(np.linalg.norm(self.readings() - expected) / np.linalg.norm(expected))


@lru_cache(maxsize=3)
def peer(size: float = SIZES[-1]) -> Peer:
    """One of pyEIT's discs, of an edge length in radii; its mesher takes seconds, and is not counted."""
    with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import pyeit.mesh
        from pyeit.eit import protocol

        mesh = pyeit.mesh.create(16, h0=size)
        return Peer(mesh, protocol.create(16, dist_exc=1, step_meas=1, parser_meas="std"))
