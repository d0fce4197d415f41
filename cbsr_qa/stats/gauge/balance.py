"""Missing runs of a crossed gauge study, and its largest balanced part: most runs, at least two per cell."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

from cbsr_qa.stats.gauge.crossed_study import count_usual_trials, on

#: Largest number of stations for which every choice is tried (2¹² of them); beyond it, only the best of each size.
_MOST_TRIED: Final = 12


@dataclass(frozen=True, slots=True)
class BalancedPart:
    """A balanced crossed part.

    Parameters
    ----------
    sensors, stations : names, sorted; empty if no two sensors have two runs each on two stations.
    trials : runs of each sensor on each station.
    kept : indices of its runs, ascending; the first ones of each cell.
    """

    sensors: tuple[str, ...]
    stations: tuple[str, ...]
    trials: int
    kept: tuple[int, ...]

    def words(self, part: str = "sensors", appraiser: str = "stations") -> str:
        """Describe its size for a reader."""
        size = f"{len(self.sensors)} {part} × {len(self.stations)} {appraiser} × {self.trials} runs"
        return f"{size} = {len(self.kept)} runs"


def missing_runs(sensors: Sequence[str], stations: Sequence[str], appraiser: str = "station") -> tuple[str, ...]:
    """Describe missing and surplus runs, one sentence each; empty for a balanced study.

    ``appraiser``: what the stations are: "station", or "operator" where people are compared.
    """
    cells = _cells(sensors, stations)
    trials = count_usual_trials(map(len, cells.values()))
    return tuple(
        f"{sensor} {on(appraiser)} {station} has "
        + (
            f"{len(run_indices)} of {_runs(trials)}"
            if len(run_indices) < trials
            else f"{_runs(len(run_indices))} instead of {trials}"
        )
        for (sensor, station), run_indices in cells.items()
        if len(run_indices) != trials
    )


def _runs(count: int) -> str:
    return f"{count} run{'s' * (count != 1)}"


def largest_balanced(sensors: Sequence[str], stations: Sequence[str]) -> BalancedPart:
    """Return the balanced part with the most runs; ties go to more sensors, then more stations.

    Parameters
    ----------
    sensors, stations : (N,) names of each run, in the order of trials.
    """
    cells = _cells(sensors, stations)
    rows, columns = sorted(set(sensors)), sorted(set(stations))
    most_trials = max(map(len, cells.values()), default=0)
    best, best_size = BalancedPart((), (), 0, ()), (0, 0, 0)
    for chosen in _choices(columns, cells):
        for trials in range(2, most_trials + 1):
            full_rows = [row for row in rows if all(len(cells[row, column]) >= trials for column in chosen)]
            new_size = (len(full_rows) * len(chosen) * trials, len(full_rows), len(chosen))
            if len(full_rows) >= 2 and new_size > best_size:
                kept_runs = sorted(
                    index for row in full_rows for column in chosen for index in cells[row, column][:trials]
                )
                best, best_size = BalancedPart(tuple(full_rows), tuple(chosen), trials, tuple(kept_runs)), new_size
    return best


def _cells(sensors: Sequence[str], stations: Sequence[str]) -> dict[tuple[str, str], list[int]]:
    cells: dict[tuple[str, str], list[int]] = {
        (row, column): [] for row in sorted(set(sensors)) for column in sorted(set(stations))
    }
    for index, cell in enumerate(zip(sensors, stations, strict=True)):
        cells[cell].append(index)
    return cells


def _choices(columns: list[str], cells: dict[tuple[str, str], list[int]]) -> Iterable[tuple[str, ...]]:
    if len(columns) <= _MOST_TRIED:
        for count in range(2, len(columns) + 1):
            yield from combinations(columns, count)
        return
    ranked = sorted(
        columns, key=lambda column: -sum(len(runs) > 1 for (_, of), runs in cells.items() if of == column)
    )
    for count in range(2, len(columns) + 1):
        yield tuple(sorted(ranked[:count]))
