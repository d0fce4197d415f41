"""Hard cases of the forward model: contrasts, contacts, slivers, units and loads that nearly coincide."""

from collections.abc import Callable
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.forward.value_range import ValueRangeError
from cbsr_qa.stability.case import Answer, HardCase, conditioned_bound
from cbsr_qa.stability.extended import exact_readings
from cbsr_qa.stability.small_sheet import reading_condition, relative_error, small_model

Array = NDArray[np.float64]

_AREA: Final = "forward model"
_FIFTY: Final = "the same equations in fifty digits, textbook form"
_SEED: Final = 20261121


def inclusion(contrast: float) -> Array:
    """Conductances (e,) of the small sheet with a round inclusion of half its radius."""
    away = np.hypot(*small_model().mesh.centroids_mm.T)
    return np.where(away < 25, contrast, 1.0)


def islands(parted: float) -> Array:
    """Good conductors round the electrodes, parted by a poor one that all current has to pass."""
    x, y = small_model().mesh.centroids_mm.T
    turn = np.arctan2(y, x) / (2 * np.pi) * 8 % 1
    return np.where((turn < 0.5) & (np.hypot(x, y) > 30), 1.0, parted)


def scattered(decades: float) -> Array:
    """Conductances whose logarithms are scattered evenly over some decades, from a fixed seed."""
    random = np.random.default_rng(_SEED)
    values: Array = 10 ** random.uniform(-decades / 2, decades / 2, len(small_model().mesh.elements))
    return values


def readings_of(conductance: Callable[[], Array], contact_mm: float = 5.0) -> Answer:
    """Readings of the small sheet against fifty digits.

    Parameters
    ----------
    conductance : gives (e,) [S].
    contact_mm : z of every electrode [Ω·mm].
    """
    values = conductance()
    model = small_model().changed(conductance=values, contact_impedance=np.full(8, contact_mm))
    exact = exact_readings(model.mesh, model.pattern, values, model.contact_impedance)
    condition = reading_condition(model)
    return Answer(relative_error(model.voltages(), exact, model.pattern), conditioned_bound(condition), condition)


def _contrast(name: str, hard: str, conductance: Callable[[], Array]) -> HardCase:
    return HardCase(name, _AREA, hard, _FIFTY, partial(readings_of, conductance))


_CONTRASTS: Final = (
    _contrast(
        "inclusion-conducts-1e8-better",
        "A load that conducts a hundred million times better than the sheet round it.",
        partial(inclusion, 1e8),
    ),
    _contrast(
        "inclusion-conducts-1e4-better", "A load that conducts ten thousand times better than the sheet.",
        partial(inclusion, 1e4),
    ),
    _contrast(
        "inclusion-conducts-1e4-worse", "A load that conducts ten thousand times worse than the sheet.",
        partial(inclusion, 1e-4),
    ),
    _contrast(
        "inclusion-conducts-1e8-worse",
        "A tear in the sheet: a hundred millionth of its conductance.",
        partial(inclusion, 1e-8),
    ),
    _contrast(
        "conductance-scattered-over-8-decades",
        "Every element of the mesh has a conductance of its own, over eight decades.",
        partial(scattered, 8.0),
    ),
)  # fmt: skip


def _beyond() -> Answer:
    return readings_of(partial(inclusion, 1e9))


_REFUSED: Final = (
    HardCase(
        "contrast-beyond-1e8",
        _AREA,
        "A contrast of a thousand million, which no sheet has: a typing error in a material.",
        "the refusal, by the elements and their conductances",
        _beyond,
        refuses=ValueRangeError,
    ),
    HardCase(
        "contact-without-impedance",
        _AREA,
        "A contact impedance of exactly zero, which the equations divide by.",
        "the refusal, by the electrode",
        partial(readings_of, partial(inclusion, 1.0), 0.0),
        refuses=NumericsError,
    ),
)

CASES: Final[tuple[HardCase, ...]] = (*_CONTRASTS, *_REFUSED)
