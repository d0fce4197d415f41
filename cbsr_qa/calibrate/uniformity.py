"""How evenly a sheet responds from place to place, with and without what the imaging makes of it."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cbsr_qa.calibrate.baseline import load_baseline, sensed_change
from cbsr_qa.calibrate.data_sheet import pooled_deviation
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.footprints import overlap_mm2
from cbsr_qa.domain.observation import LoadObservation, RunObservation
from cbsr_qa.domain.sensor import Response

#: Of the peak of a head's modelled image: regions over which its mean is less do not lie on the head.
_ON_HEAD: Final = 0.5


@dataclass(frozen=True, slots=True)
class PlaceResponse:
    """How a location responds to one strain.

    Parameters
    ----------
    location, x_mm, y_mm : of its loads.
    baseline : ρ₀ of Eq 7, mean over the loads, relative image units.
    responses : of each load, the same over what the linearised model of an even sheet images there: 1 where the sheet
        answers as that model with the material's α.
    """

    location: str
    x_mm: float
    y_mm: float
    baseline: float
    responses: tuple[float, ...]

    @property
    def response(self) -> float:
        """Mean over the loads."""
        return float(np.mean(self.responses))


def place_responses(run: RunObservation, loads: Sequence[LoadObservation]) -> tuple[tuple[PlaceResponse, ...], float]:
    """Response of every location at the strain most locations were pressed at, the highest of several such.

    The image of one and the same change of conductance is larger where the electrodes see better, and so is ρ₀: on
    an even sheet of 100 mm it doubles from the centre to 30 mm. That much is the imaging's, and the linearised model
    of an even sheet says how much: the image of the head there with a contrast of one, R J s for the share s of each
    element it covers, averaged over the very elements in which the load was sensed.

    Returns
    -------
    Locations in the order of their first press, and the strain. Loads without a ρ₀, or that were sensed elsewhere
    than on the head (the model's mean over the sensed elements is under half of its peak), are left out.

    Raises
    ------
    NumericsError
        If no load gave a ρ₀.
    """
    found: dict[float, dict[tuple[str, float, float], list[tuple[float, float]]]] = defaultdict(
        lambda: defaultdict(list)
    )
    why = "no location was pressed at a nominal strain by itself"
    modelled: dict[tuple[float, float], np.ndarray] = {}
    for load in loads:
        stress = run.record.material.against_stress
        baseline = load_baseline(load, stress, run.noise_images, run.main_mask)
        view, place = load.mask(run.main_mask), load.record.load
        if baseline.value is None or view is None or view.sensed is None:
            why = baseline.why
            continue
        where = (place.x_mm, place.y_mm)
        if where not in modelled:
            modelled[where] = _image_of_head(run, load)
        image = modelled[where]
        gain = float(sensed_change(image, view.sensed, load.response))
        if not gain > _ON_HEAD * float(np.abs(image).max()):
            why = f"{place.label} was sensed elsewhere than a head there is imaged"
            continue
        found[round(place.strain, 9)][(place.label, *where)].append((baseline.value, baseline.value / gain))
    if not found:
        raise NumericsError(f"no location gave a baseline conductance: {why}")
    strain = max(found, key=lambda level: (len(found[level]), level))
    return tuple(_place(place, values) for place, values in found[strain].items()), strain


def _image_of_head(run: RunObservation, load: LoadObservation) -> np.ndarray:
    """Image of the head at a load's place with a contrast of one, of the sign of the response, (e,)."""
    problem, place = run.reconstruction.problem, load.record.load
    mesh = problem.mesh
    share = overlap_mm2(load.indenter.at(place.x_mm, place.y_mm), mesh.corners_mm) / mesh.areas_mm2
    sign = -1.0 if load.response is Response.DECREASE else 1.0
    return np.asarray(sign * (run.reconstruction.matrix @ (problem.jacobian @ share)))


def scatter_of_presses(places: Sequence[PlaceResponse]) -> float | None:
    """Spread that the scatter of single presses alone makes over an even sheet, over its mean; None if unknown.

    Each place is a mean over its presses; their scatter is pooled over the places that were pressed again.
    """
    mean = float(np.mean([place.response for place in places]))
    try:
        single = pooled_deviation([place.responses for place in places]).value
    except NumericsError:
        return None
    return single / mean * float(np.sqrt(np.mean([1 / len(place.responses) for place in places])))


def _place(place: tuple[str, float, float], values: Sequence[tuple[float, float]]) -> PlaceResponse:
    baseline = float(np.mean([one for one, _ in values]))
    return PlaceResponse(*place, baseline, tuple(response for _, response in values))
