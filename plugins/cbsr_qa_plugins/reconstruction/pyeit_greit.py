"""pyEIT's GREIT, for comparison."""

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.reconstruction import ImagingProblem, LinearReconstruction
from cbsr_qa.reconstruct.options import number, whole
from cbsr_qa_plugins.reconstruction._pyeit import (
    check_determined,
    checked_options,
    finished,
    invertible,
    pyeit_problem,
    quiet,
    solver,
)

Array = NDArray[np.float64]

_NAME = "pyeit-greit"
_PIXELS = (8, 256)


class PyeitGreit:
    """pyEIT 1.2.4's GREIT ("distribution method", no training targets) on a raster, with point electrodes.

    It gives values at the points of its raster; our elements interpolate linearly between them, at their centroids.

    Parameters
    ----------
    p, lamb, s, ratio : pyEIT's, by default as in its examples; ``ratio`` is the radius of its blur, of the largest
        distance on the raster, ``s`` how sharply the blur ends.
    n : points of the raster along each side.
    mesh_size : edge length of pyEIT's mesh, of the radius; 0.07 gives about 1400 elements and readings within 0.5 %.
    """

    weighs_noise = False

    def __init__(
        self,
        *,
        p: float = 0.5,
        lamb: float = 0.01,
        n: int = 32,
        s: float = 20.0,
        ratio: float = 0.1,
        mesh_size: float = 0.07,
    ) -> None:
        self._p, self._lamb, self._mesh_size = checked_options(_NAME, p=p, lamb=lamb, mesh_size=mesh_size)
        points, s, ratio = whole(_NAME, "n", n), number(_NAME, "s", s), number(_NAME, "ratio", ratio)
        if not _PIXELS[0] <= points <= _PIXELS[1]:
            raise NumericsError(
                f"n is {n}; the raster must have {_PIXELS[0]} to {_PIXELS[1]} points a side",
                remedy="32 is usual",
            )
        if not (0 < ratio < 1 and 0 < s < 1e3):
            raise NumericsError(
                f"ratio is {ratio} and s {s}; ratio must be in 0 … 1 and s in 0 … 1000",
                remedy="0.1 and 20 are usual",
            )
        self._options = {"p": self._p, "lamb": self._lamb, "n": points, "s": s, "ratio": ratio}

    def prepare(self, problem: ImagingProblem) -> LinearReconstruction:
        """Prepare the imaging matrix.

        Raises
        ------
        NumericsError
            If the sheet is not round, a reading touches a driven electrode, or lamb is lost in rounding.
        """
        given = pyeit_problem(problem, self._mesh_size)
        greit = solver("pyeit.eit.greit:GREIT", given)
        with quiet(), invertible():
            greit.setup(method="dist", perm=1, jac_normalized=False, **self._options)
        check_determined(np.einsum("me,me->m", greit.J, greit.J), self._p, self._lamb)
        x, y = np.asarray(greit.xg)[0], np.asarray(greit.yg)[:, 0]
        between = _between(x, y, problem.mesh.centroids_mm / problem.sensor_type.radius_mm)
        return finished(_NAME, problem, -(between @ np.asarray(greit.H, dtype=np.float64)), self._lamb)


def _between(x: Array, y: Array, points: Array) -> sparse.csr_matrix:
    """Bilinear interpolation from a raster (rows y, columns x) to points (k, 2): (k, pixels) sparse.

    Points beyond the raster take its edge; pyEIT's ends one step before the disc does.
    """
    places = []
    for axis, along in ((x, points[:, 0]), (y, points[:, 1])):
        at = np.clip((along - axis[0]) / (axis[1] - axis[0]), 0, len(axis) - 1)
        low = np.minimum(at.astype(np.int64), len(axis) - 2)
        places.append((low, at - low))
    (column, right), (row, up) = places
    corners = [(row + i) * len(x) + column + j for i in (0, 1) for j in (0, 1)]
    weights = [(up if i else 1 - up) * (right if j else 1 - right) for i in (0, 1) for j in (0, 1)]
    index = np.tile(np.arange(len(points)), 4)
    entries = (np.concatenate(weights), (index, np.concatenate(corners)))
    return sparse.csr_matrix(entries, shape=(len(points), len(x) * len(y)))
