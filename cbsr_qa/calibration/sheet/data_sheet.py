"""Data-sheet numbers of a sensor from repeated loads, and the evenness of its sheet's response."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from cbsr_qa.calibration.fits.estimates import pool_deviations
from cbsr_qa.calibration.sheet.baseline import load_baseline, measure_sensed_change
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.geometry.footprints import overlap_mm2
from cbsr_qa.domain.results.observation import LoadObservation, RunObservation

#: Share of the peak of a head's modelled image: regions with a smaller mean are not on the head.
_ON_HEAD: Final = 0.5


@dataclass(frozen=True, slots=True)
class PlaceResponse:
    """Response of a location to one strain.

    Parameters
    ----------
    location, x_mm, y_mm : name and place of the loads.
    baseline : ρ₀ of Eq 7, mean over the loads [relative image units].
    responses : ρ₀ of each load over the image of the linearised model of an even sheet there: 1 if the sheet
        responds as that model with the material's α.
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
    """Response of every location at the most common strain, the highest of several such.

    NumericsError if no load gave a ρ₀.

    Returns
    -------
    Locations in the order of their first press, and the strain. Loads without a ρ₀, or sensed off the head (the
    model's mean over the sensed elements is under half of its peak), are left out.
    """
    by_strain: dict[float, dict[tuple[str, float, float], list[tuple[float, float]]]] = defaultdict(
        lambda: defaultdict(list)
    )
    why = "no location was pressed at a nominal strain by itself"
    modelled: dict[tuple[float, float], np.ndarray] = {}
    reconstruction, problem = run.reconstruction, run.reconstruction.problem
    for load in loads:
        stress = run.record.material.against_stress
        baseline = load_baseline(load, stress, run.noise_images, run.main_mask)
        view = load.mask(run.main_mask)
        if baseline.value is None or view is None or view.sensed is None:
            why = baseline.why
            continue
        if load.place_mm not in modelled:
            # Image of the head with a contrast of one, of the sign of the response, (e,).
            share = overlap_mm2(load.pressed, problem.mesh.corners_mm) / problem.mesh.areas_mm2
            modelled[load.place_mm] = load.response.sign * (reconstruction.matrix @ (problem.jacobian @ share))
        image = modelled[load.place_mm]
        gain = float(measure_sensed_change(image, view.sensed, load.response))
        if not gain > _ON_HEAD * float(np.abs(image).max()):
            why = f"{load.record.load.label} was not sensed under its head"
            continue
        place = (load.record.load.label, *load.place_mm)
        by_strain[round(load.record.load.strain, 9)][place].append((baseline.value, baseline.value / gain))
    if not by_strain:
        raise NumericsError(f"no location gave a baseline conductance: {why}")
    strain = max(by_strain, key=lambda level: (len(by_strain[level]), level))
    responses = []
    for place, values in by_strain[strain].items():
        baselines, gained = zip(*values, strict=True)
        responses.append(PlaceResponse(*place, float(np.mean(baselines)), gained))
    return tuple(responses), strain


def scatter_of_presses(places: Sequence[PlaceResponse]) -> float | None:
    """Spread over an even sheet from the scatter of single presses alone, over its mean; None if unknown."""
    mean = float(np.mean([place.response for place in places]))
    try:
        single = pool_deviations([place.responses for place in places]).value
    except NumericsError:
        return None
    return single / mean * float(np.sqrt(np.mean([1 / len(place.responses) for place in places])))
