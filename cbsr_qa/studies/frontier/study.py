"""``cbsr-qa frontier``: the cost of accuracy in computing and station time, and a recommended setting."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from os import cpu_count
from typing import Final, TypeVar

from cbsr_qa.config.paths import var_folder, writable_folder
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.studies.frontier.computer.sweeps import mark_worth_of_computer, plan_computer_work
from cbsr_qa.studies.frontier.files import Files, write_recipe
from cbsr_qa.studies.frontier.point import BatchAsPrior, Point, TimeBasis, restore
from cbsr_qa.studies.frontier.recommend import Recommendation, Target, recommend
from cbsr_qa.studies.frontier.sensors import station_seconds
from cbsr_qa.studies.frontier.setting import Setting
from cbsr_qa.studies.frontier.station import PAPER, Tried, combine_trials, plan_confirming_work, plan_station_work
from cbsr_qa.studies.sweep import Kept, Tell, Work, compute_pieces

#: Processes of timed work, which must not share a core with others.
_ALONE: Final = 1
_STATION_PROCESSES: Final = min(2, cpu_count() or 1)

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Frontier:
    """Result of a sweep; a setting is recommended only if the station was swept and one met the target.

    Parameters
    ----------
    guess_mm : of presses, the error of guessing: the mean distance of their places from the middle of all.
    batch : of stored runs, what the batch as prior changes.
    """

    quick: bool
    points: tuple[Point, ...]
    recommended: Recommendation
    guess_mm: float | None = None
    batch: BatchAsPrior | None = None


def frontier(
    clocks: Sequence[TimeBasis], target: Target, files: Files, *, quick: bool = False, fresh: bool = False, tell: Tell
) -> Frontier:
    """Run the requested sweep, choose a setting, and write its recipe.

    A setting chosen by the whole sweep is simulated again on new sensors. Finished pieces are kept in ``frontier/``
    of the var folder, so that an interrupted sweep resumes. Simulations run on two cores; times of the computer are
    measured one after the other.

    Parameters
    ----------
    fresh : discard finished pieces.

    Raises
    ------
    RefusedError
        Before the sweep if a file cannot be written, and after it if there is no recipe to write.
    ConfigError, StoreError
        If the folder cannot be written to, or has other content.
    """
    files.check(clocks)
    folder = writable_folder(var_folder() / "frontier")

    def swept(kind: type[T], work: Iterable[Work], name: str, processes: int) -> list[T]:
        path = folder / name
        pieces = compute_pieces(list(work), Kept(path), tell, processes=processes)
        return [restore(kind, document) for documents in pieces.values() for document in documents]

    def confirm(setting: Setting) -> Point:
        trials = swept(Tried, plan_confirming_work(setting), "station.jsonl", _STATION_PROCESSES)
        ((_, point),) = combine_trials(trials, station_seconds)
        return point

    if fresh:
        for clock in clocks:
            (folder / f"{clock}.jsonl").unlink(missing_ok=True)
    station_trials: list[tuple[Setting, Point]] = []
    computer_points: list[Point] = []
    if TimeBasis.STATION in clocks:
        trials = swept(Tried, plan_station_work(quick=quick), "station.jsonl", _STATION_PROCESSES)
        station_trials = combine_trials(trials, station_seconds)
    if TimeBasis.COMPUTER in clocks:
        computer_points = mark_worth_of_computer(
            swept(Point, plan_computer_work(quick=quick), "computer.jsonl", _ALONE)
        )
    recommended = _recommend(station_trials, target, confirm)
    if files.recipe is not None:
        write_recipe(recommended, files.recipe)
        recommended = replace(recommended, recipe=str(files.recipe))
    return Frontier(quick, (*(point for _, point in station_trials), *computer_points), recommended)


def _recommend(
    tried: Sequence[tuple[Setting, Point]], target: Target, confirm: Callable[[Setting], Point]
) -> Recommendation:
    """The recommended setting, or why none is recommended."""
    if not tried:
        return Recommendation(None, None, None, "only the computer's clock was swept")
    paper = next((point for setting, point in tried if setting == PAPER), None)
    usable = {setting: point for setting, point in tried if setting.is_recipe}
    try:
        return recommend(list(usable.items()), target, paper=paper, confirm=confirm)
    except RefusedError as error:
        return Recommendation(None, None, None, f"{error.reason}; {error.remedy}")
