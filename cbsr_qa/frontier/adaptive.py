"""Which place to press next: where the map learned so far is least sure, or farthest from all that were pressed.

What is asked: does it pay to look at the loads before the next one is chosen? Both ways choose among the places of a
run that pressed them all.
"""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cbsr_qa.analysis.fewer_places import farthest_first
from cbsr_qa.analysis.run_force import learned_from
from cbsr_qa.domain.observation import LoadObservation, RunObservation
from cbsr_qa.frontier.setting import GRID
from cbsr_qa.frontier.trial import only

Array = NDArray[np.float64]

#: Places that are pressed before anything can be said of a map, and how many are then chosen at a time.
FIRST: Final = 6
_AT_A_TIME: Final = 3
#: Places chosen together are at least so far apart: one press says much of its neighbourhood.
_APART_MM: Final = 15.0


def least_sure_first(run: RunObservation, count: int) -> list[int]:
    """Choose places of a run's grid, each where the map learned from those before it is least sure.

    Returns
    -------
    Numbers of the grid's loads, in the order in which they would be pressed.

    Raises
    ------
    CbsrError
        If no map can be learned from the first ones.
    """
    grid = [load for load in run.loads if load.phase == GRID]
    places = _places(grid)
    chosen = farthest_first(places, min(FIRST, count))
    while len(chosen) < count:
        some = {id(grid[k]) for k in chosen}
        found = learned_from(only(run, _wanted(some)))
        assert found.learned is not None
        _, variance = found.learned.response.predict(places)
        chosen += _next(places, variance, chosen, min(_AT_A_TIME, count - len(chosen)))
    return chosen


def _wanted(some: set[int]) -> Callable[[LoadObservation], bool]:
    return lambda load: load.phase != GRID or id(load) in some


def _next(places: Array, variance: Array, chosen: Sequence[int], count: int) -> list[int]:
    """The least sure places, apart from each other; fewer apart where there are no others."""
    picked: list[int] = []
    for apart_mm in (_APART_MM, 0.0):
        for k in np.argsort(-variance).tolist():
            taken = k in chosen or k in picked
            near = any(np.hypot(*(places[k] - places[one])) < apart_mm for one in picked)
            if len(picked) < count and not taken and not near:
                picked.append(k)
    return picked


def _places(loads: Sequence[LoadObservation]) -> Array:
    return np.array([(load.record.load.x_mm, load.record.load.y_mm) for load in loads]).reshape(-1, 2)


def grid_places(run: RunObservation) -> Array:
    """Places (n, 2) of the grid's loads, in order."""
    return _places([load for load in run.loads if load.phase == GRID])
