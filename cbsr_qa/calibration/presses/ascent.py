"""Newton's method towards a maximum, from several starts at once."""

from collections.abc import Callable
from typing import Final

import numpy as np

from cbsr_qa.domain.numbers import Array, Indices

#: Values (k,), slopes (k, p) and bends (k, p, p) at parameters (k, p) of some of the starts (k,).
Jet = Callable[[Array, Indices], tuple[Array, Array, Array]]

#: Parameters are of order one: longest step, step that ends an ascent, and most steps.
_LONGEST, _SHORTEST, _MOST_STEPS = 1.0, 1e-3, 60
#: Least curvature over the largest, at first, and its factor after a step up and after a failed one.
_STIFFNESS: Final = 1e-2
_LESS, _MORE = 0.2, 6.0


def ascend(jet: Jet, starts: Array) -> tuple[Array, Array]:
    """Nearest maxima: parameters (n, p) and values (n,), from starts (n, p).

    Curvatures count by their size, so that steps lead up from saddles too.
    """
    parameters, climbing = starts.copy(), np.arange(len(starts))
    value, slope, bend = jet(parameters, climbing)
    stiffness = np.full(len(parameters), _STIFFNESS)
    for _ in range(_MOST_STEPS):
        step = _steps(slope[climbing], bend[climbing], stiffness[climbing])
        new_jet = jet(parameters[climbing] + step, climbing)
        improved_mask = new_jet[0] > value[climbing]
        improved_starts = climbing[improved_mask]
        parameters[improved_starts] += step[improved_mask]
        value[improved_starts], slope[improved_starts], bend[improved_starts] = (
            part[improved_mask] for part in new_jet
        )
        stiffness[climbing] *= np.where(improved_mask, _LESS, _MORE)
        climbing = climbing[np.linalg.norm(step, axis=1) > _SHORTEST]
        if not len(climbing):
            break
    return parameters, value


def _steps(slope: Array, bend: Array, stiffness: Array) -> Array:
    curvature, axes = np.linalg.eigh(bend)
    size = np.abs(curvature)
    size += stiffness[:, None] * np.maximum(size.max(axis=1, keepdims=True), np.finfo(np.float64).tiny)
    slope_along = (slope[:, None, :] @ axes)[:, 0] / size
    step: Array = (axes @ slope_along[..., None])[..., 0]
    length = np.linalg.norm(step, axis=1, keepdims=True)
    shortened: Array = step * (_LONGEST / np.maximum(length, _LONGEST))
    return shortened
