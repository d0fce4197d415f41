"""Prior weights of the image, the R of (JᵀWJ + λ²R)."""

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import NumericsError

Array = NDArray[np.float64]


def noser(jacobian: Array, exponent: float) -> Array:
    """Diagonal of the NOSER prior, diag(JᵀJ)^p (Cheney et al. 1990; exponents below 1 are EIDORS's).

    p = 0 is Tikhonov's identity, p = 1 makes the penalty as strong where the readings are sensitive as elsewhere.

    Parameters
    ----------
    jacobian : (m, e). exponent : p in 0 … 1.

    Returns
    -------
    (e,) float64, positive.

    Raises
    ------
    NumericsError
        If p is out of range, or an element is felt by no reading at all.
    """
    if not 0 <= exponent <= 1:
        raise NumericsError(f"NOSER exponent {exponent} is not in 0 … 1")
    squared = np.einsum("me,me->e", jacobian, jacobian)
    if not (squared > 0).all():
        raise NumericsError(f"{int((squared <= 0).sum())} image elements are felt by no reading that is left")
    weights: Array = squared**exponent
    return weights
