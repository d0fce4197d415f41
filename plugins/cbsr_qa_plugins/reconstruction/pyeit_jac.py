"""pyEIT's one-step Gauss–Newton (JAC), for comparison."""

import numpy as np

from cbsr_qa.domain.reconstruction import ImagingProblem, LinearReconstruction
from cbsr_qa.reconstruct.overlap import overlap_fractions
from cbsr_qa_plugins.reconstruction._pyeit import (
    check_determined,
    checked_options,
    finished,
    invertible,
    pyeit_problem,
    quiet,
    solver,
)


class PyeitJac:
    """x = (JᵀJ + lamb·diag(JᵀJ)^p)⁻¹Jᵀ y as pyEIT 1.2.4 computes it, on its own mesh with point electrodes.

    Each of our elements takes the mean of the triangles of pyEIT's mesh it lies in, weighed by area.

    Parameters
    ----------
    p, lamb : pyEIT's, by default as in its examples.
    mesh_size : edge length of pyEIT's mesh, of the radius; 0.07 gives about 1400 elements and readings within 0.5 %.
        It inverts a matrix as large as their number.
    """

    weighs_noise = False

    def __init__(self, *, p: float = 0.5, lamb: float = 0.01, mesh_size: float = 0.07) -> None:
        self._p, self._lamb, self._mesh_size = checked_options("pyeit-jac", p=p, lamb=lamb, mesh_size=mesh_size)

    def prepare(self, problem: ImagingProblem) -> LinearReconstruction:
        """Prepare the imaging matrix.

        Raises
        ------
        NumericsError
            If the sheet is not round, a reading touches a driven electrode, or lamb is lost in rounding.
        """
        given = pyeit_problem(problem, self._mesh_size)
        jac = solver("pyeit.eit.jac:JAC", given)
        with quiet(), invertible():
            jac.setup(p=self._p, lamb=self._lamb, method="kotre", perm=1, jac_normalized=False)
        check_determined(np.einsum("me,me->e", jac.J, jac.J), self._p, self._lamb)
        share = overlap_fractions(problem.mesh, given.elements)
        return finished("pyeit-jac", problem, -(share @ np.asarray(jac.H, dtype=np.float64)), self._lamb)
