"""The error that all forces of a calibration share, as far as the station states its standards. Numpy alone.

A load cell that reads (1 + ε) F makes every estimate (1 + ε) times too large. The area of the head that calibrated
cancels in its own forces; in those of another head its error remains, because the map relates readings to stress.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cbsr_qa.calibration.force.inverse import Flag, Forces
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.plan.standards import ReferenceStandard, StandardRole, find_standard
from cbsr_qa.domain.readings.loads import Indenter


class SharedError:
    """Standard error that all forces of one calibration have in common.

    Parameters
    ----------
    standards : reference standards of the station that calibrated; those that are missing add nothing.
    head : head that calibrated; None where forces of other heads are not told.
    """

    def __init__(self, standards: Sequence[ReferenceStandard], head: Indenter | None = None) -> None:
        load_cell = find_standard(standards, StandardRole.LOAD_CELL)
        indenter = find_standard(standards, StandardRole.INDENTER)
        self._relative, self._offset_N, self._area = 0.0, 0.0, 0.0
        if load_cell is not None and load_cell.unit == "N":
            self._offset_N = load_cell.standard_uncertainty
        elif load_cell is not None:
            self._relative = load_cell.standard_uncertainty
        if indenter is not None and head is not None:
            u = indenter.standard_uncertainty
            self._area = 2 * u / head.diameter_mm if indenter.unit == "mm" else u

    def stderr_N(self, force_N: Array, *, other_head: bool = False) -> Array:
        """Return the shared standard error (n,) of forces (n,) [N], which may be of another head."""
        relative = float(np.hypot(self._relative, self._area if other_head else 0.0))
        return np.hypot(relative * force_N, self._offset_N)

    def add(self, forces: Forces, *, other_head: bool = False) -> Forces:
        """Add it to errors of scatter alone; where no load was detected there is no force to add it to."""
        shared_N = self.stderr_N(forces.force_N, other_head=other_head)
        shared_N = np.where(forces.flags & int(Flag.NOT_DETECTED) == 0, shared_N, 0.0)
        return replace(forces, stderr_N=np.hypot(forces.stderr_N, shared_N), shared_stderr_N=shared_N)
