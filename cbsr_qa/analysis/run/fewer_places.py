"""Prediction of the response map with fewer loads, from the run itself.

The map is learned again from some of the places, spread as evenly as possible, and compared with the loads at the
other places. Between pressed places only the map's own stated error applies.
"""

from dataclasses import dataclass
from itertools import compress
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.analysis.run.force import RunForce
from cbsr_qa.analysis.run.force_quality import calibration_radius_mm, map_quality, places_mm
from cbsr_qa.calibration.sheet.response_map import FEWEST, ResponseMap, learn_response, sheet_places
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.numbers import Array
from cbsr_qa.domain.results.observation import LoadObservation, RunObservation

Chosen = NDArray[np.bool_]

#: Shares of the places that are tried.
_SHARES: Final = (0.35, 0.5, 0.7)
#: Number of choices, each from another first place, which matters with few places.
_WAYS: Final = 3


@dataclass(frozen=True, slots=True)
class MapCost:
    """A map learned from some loads.

    Parameters
    ----------
    places, loads : number it was learned from.
    station_s : their share of the time of their phases, including travel, surface finding and rests.
    stated : relative standard error of the map within the calibrated area, root mean square.
    seen : relative error at the left-out places, root mean square, less the noise of their own loads; None without
        any.
    expected : error that the map states there; None likewise.
    """

    places: int
    loads: int
    station_s: float
    stated: float
    seen: float | None = None
    expected: float | None = None


def map_costs(run: RunObservation, force: RunForce) -> tuple[MapCost, ...]:
    """Return maps from subsets of places, and from one load per place; the whole run's map comes last.

    Parameters
    ----------
    force : the force of the run; empty result if it was not learned.

    Returns
    -------
    In order of places; empty with too few places to leave some out.
    """
    if force.learned is None:
        return ()
    loads = _Loads(run, force)
    counts = sorted({round(share * loads.count) for share in _SHARES})
    costs = [loads.cost_by_places(count) for count in counts if FEWEST < count < loads.count]
    if not costs:
        return ()
    once = loads.first_of_each()
    return (*costs, *([loads.cost(once)] if not once.all() else []), loads.predict_all())


def farthest_first(places_mm: Array, count: int, *, first: int | None = None) -> list[int]:
    """Choose places one by one, each the farthest from those chosen.

    Parameters
    ----------
    places_mm : (n, 2).
    first : index of the first place; by default the one nearest to the centre.

    Raises
    ------
    NumericsError
        If there are fewer places than requested.
    """
    if count > len(places_mm):
        raise NumericsError(f"cannot choose {count} places from {len(places_mm)}")
    chosen_indices = [int(np.hypot(*places_mm.T).argmin()) if first is None else first]
    while len(chosen_indices) < count:
        distances_mm = np.hypot(*(places_mm[:, None] - places_mm[chosen_indices]).transpose(2, 0, 1)).min(axis=1)
        chosen_indices.append(int(distances_mm.argmax()))
    return chosen_indices


class _Loads:
    def __init__(self, run: RunObservation, force: RunForce) -> None:
        learned = force.learned
        assert learned is not None
        responds = np.isfinite(learned.ratio)
        used_loads = list(compress(force.used, responds))
        self._places = force.sheet_pose.places_mm(places_mm(used_loads))
        self._log = np.log(learned.ratio[responds]) + _line_log_ratio(run, force, used_loads)
        self._variance = (learned.ratio_stderr[responds] / learned.ratio[responds]) ** 2
        self._scatter = learned.model.scatter
        # Each load's share of the time of its phase: surfaces may be found before the first press.
        share_s = {p.name: (p.ended_s - p.started_s) / len(p.loads) for p in run.record.phases if p.loads}
        self._seconds = np.array([share_s[load.phase] for load in used_loads])
        self._radius_mm = run.record.sensor_type.radius_mm
        radius_mm = calibration_radius_mm(force)
        area = sheet_places(learned.model, stride=2)
        self._area = area[np.hypot(*area.T) <= max(radius_mm, float(np.hypot(*area.T).min()))]
        self._stated = map_quality(learned, radius_mm).rms_error
        self._at, self._which = np.unique(self._places, axis=0, return_inverse=True)
        self._which = self._which.ravel()

    @property
    def count(self) -> int:
        return len(self._at)

    def first_of_each(self) -> Chosen:
        first_mask: Chosen = np.zeros(len(self._which), dtype=np.bool_)
        first_mask[np.unique(self._which, return_index=True)[1]] = True
        return first_mask

    def cost(self, chosen: Chosen) -> MapCost:
        _, variance = self._learn_response(chosen).predict(self._area)
        count = len(np.unique(self._which[chosen]))
        return MapCost(count, int(chosen.sum()), float(self._seconds[chosen].sum()), _rms(variance))

    def predict_all(self) -> MapCost:
        """Prediction of all loads, as the calibration states it."""
        return MapCost(self.count, len(self._which), float(self._seconds.sum()), self._stated)

    def cost_by_places(self, count: int) -> MapCost:
        """Predictions from all loads at some places, for the sheet and the left-out places, over several choices."""
        ways = np.unique(np.linspace(0, self.count - 1, _WAYS).astype(np.intp)).tolist()
        place_masks = [np.isin(np.arange(self.count), farthest_first(self._at, count, first=way)) for way in ways]
        costs = [self.cost(places[self._which]) for places in place_masks]
        squares = np.array([self._holdout_errors(places) for places in place_masks]).mean(axis=0)
        return MapCost(
            count,
            round(float(np.mean([cost.loads for cost in costs]))),
            float(np.mean([cost.station_s for cost in costs])),
            _rms(np.array([cost.stated**2 for cost in costs])),
            float(np.sqrt(max(squares[0], 0.0))),
            float(np.sqrt(squares[1])),
        )

    def _holdout_errors(self, kept: Chosen) -> tuple[float, float]:
        """Mean square error at the left-out places, noise removed, and the stated one."""
        mean, variance = self._learn_response(kept[self._which]).predict(self._at[~kept])
        weight = 1 / (self._variance + self._scatter**2)
        total = np.bincount(self._which, weight)
        mean_log = np.bincount(self._which, weight * self._log) / total
        error = (mean - mean_log[~kept]) ** 2 - 1 / total[~kept]
        return float(error.mean()), float(variance.mean())

    def _learn_response(self, chosen: Chosen) -> ResponseMap:
        return learn_response(
            self._places[chosen], self._log[chosen], self._variance[chosen], radius_mm=self._radius_mm
        )


def _line_log_ratio(run: RunObservation, force: RunForce, used: list[LoadObservation]) -> Array:
    """Logarithm of the sensor's own line over the material's, for each load."""
    assert force.learned is not None
    stress = np.array([load.force_N or 0.0 for load in used]) * 1e3 / run.record.indenter.area_mm2
    given_line, learned_line = run.record.material.against_stress, force.learned.line
    nominal = given_line.slope.value * stress + given_line.intercept.value
    return np.log(nominal / (learned_line.slope.value * stress + learned_line.intercept.value))


def _rms(squares: Array) -> float:
    return float(np.sqrt(squares.mean()))
