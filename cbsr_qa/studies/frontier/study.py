"""``cbsr-qa frontier``: the cost of accuracy in computing and station time, and a recommended setting."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from os import cpu_count
from pathlib import Path
from typing import Annotated, Any, Final

from pydantic import Field

import cbsr_qa
from cbsr_qa.config import var_folder, writable_folder
from cbsr_qa.domain import RefusedError
from cbsr_qa.report import json_document
from cbsr_qa.studies.frontier.computer import computer_tasks, worth_their_time
from cbsr_qa.studies.frontier.files import Files, write_recipe
from cbsr_qa.studies.frontier.point import Accuracy, Knob, Point, Task, TimeBasis, stored
from cbsr_qa.studies.frontier.points import station_points, worth_the_station
from cbsr_qa.studies.frontier.recommend import Recommended, Wish, recommend
from cbsr_qa.studies.frontier.sensors import station_seconds
from cbsr_qa.studies.frontier.setting import Setting
from cbsr_qa.studies.frontier.station import PAPER, Tried, station_work
from cbsr_qa.studies.sweep import Documents, Kept, Work, worked_out

#: Version of simulation and evaluation: pieces of other versions are computed again.
_VERSION: Final = 3
#: Pieces of work whose timed parts must not share a core with others.
_ALONE: Final = 1

Tell = Callable[[int, int, str], None]


@dataclass(frozen=True, slots=True)
class Needed:
    """Presses needed by extrapolation, and the numbers one standard error below and above."""

    presses: int
    low: int
    high: int


@dataclass(frozen=True, slots=True)
class Recommendation:
    """The recommended setting (or None), the reason, and the file of its recipe.

    Parameters
    ----------
    needed : presses for a wish beyond those tried; None unless their errors can be extrapolated to it.
    """

    setting: Mapping[str, Knob] | None
    accuracy: Mapping[str, Accuracy] | None
    station_s: float | None
    why: str
    recipe: str | None = None
    needed: Needed | None = None


@dataclass(frozen=True, slots=True)
class Frontier:
    """Result of a sweep; a recipe is chosen only if the station was swept and a setting met the wish."""

    quick: bool
    points: tuple[Point, ...]
    recommended: Recommendation
    chosen: Annotated[Recommended | None, Field(exclude=True)] = None


def frontier(
    clocks: Sequence[TimeBasis],
    wish: Wish,
    files: Files,
    *,
    quick: bool = False,
    fresh: bool = False,
    tell: Tell = lambda done, of, what: None,
    processes: int | None = None,
    folder: Path | None = None,
) -> Frontier:
    """Run the requested sweep, choose a setting, and write its recipe.

    Finished pieces are kept in ``frontier/`` of the var folder, so that an interrupted sweep resumes.

    Parameters
    ----------
    fresh : discard finished pieces.
    processes : number for simulations; times of the computer are always measured one after the other.

    Raises
    ------
    RefusedError
        Before the sweep if a file cannot be written, and after it if there is no recipe to write.
    ConfigError, StoreError
        If the folder cannot be written to, or has other content.
    """
    files.check(clocks)
    where = writable_folder((folder or var_folder()) / "frontier")
    tried: list[tuple[Setting, Point]] = []
    points: list[Point] = []
    if TimeBasis.STATION in clocks:
        tried = _station(_kept(where / "station.jsonl", fresh), quick, tell, processes)
        points += _compared([point for _, point in tried], worth_the_station)
    if TimeBasis.COMPUTER in clocks:
        points += _compared(_computer(_kept(where / "computer.jsonl", fresh), quick, tell), worth_their_time)
    chosen, why_not = _chosen(tried, wish)
    if files.recipe is not None:
        if chosen is None:
            raise RefusedError(f"there is no recipe to write: {why_not}")
        write_recipe(chosen, files.recipe)
    recommended = Recommendation(None, None, None, why_not)
    if chosen is not None:
        point, recipe = chosen.point, None if files.recipe is None else str(files.recipe)
        recommended = Recommendation(point.knobs, point.accuracy, point.station_s, chosen.why, recipe)
    return Frontier(quick, tuple(points), recommended, chosen)


def _kept(path: Path, fresh: bool) -> Kept:
    if fresh:
        path.unlink(missing_ok=True)
    return Kept(path)


def _compared(points: Sequence[Point], worth: Callable[[Sequence[Point]], tuple[bool, ...]]) -> list[Point]:
    return [replace(point, pareto=on) for point, on in zip(points, worth(points), strict=True)]


def _station(kept: Kept, quick: bool, tell: Tell, processes: int | None) -> list[tuple[Setting, Point]]:
    work = [
        Work(f"station {_VERSION}/{cbsr_qa.__version__}/{key}", what, partial(_tried, run))
        for key, what, run in station_work(quick=quick)
    ]
    count = min(2, cpu_count() or 1) if processes is None else processes
    pieces = worked_out(work, kept, tell, processes=count)
    return station_points(
        [stored(Tried, document) for documents in pieces.values() for document in documents], _seconds
    )


def _computer(kept: Kept, quick: bool, tell: Tell) -> list[Point]:
    work = [Work(task.key, task.what, partial(_measured, task)) for task in computer_tasks(quick=quick)]
    pieces = worked_out(work, kept, tell, processes=_ALONE)
    return [stored(Point, document) for documents in pieces.values() for document in documents]


def _tried(run: Callable[[], list[Any]]) -> Documents:
    return [json_document(tried) for tried in run()]


def _measured(task: Task) -> Documents:
    return [json_document(task.run())]


@lru_cache(maxsize=256)
def _seconds(setting: Setting) -> float:
    return station_seconds(setting.recipe(), setting.frame_period_s)


def _chosen(tried: Sequence[tuple[Setting, Point]], wish: Wish) -> tuple[Recommended | None, str]:
    """The recommended setting, or why none is recommended."""
    if not tried:
        return None, "only the computer's clock was swept"
    paper = next((point for setting, point in tried if setting == PAPER), None)
    usable = list({setting: (setting, point) for setting, point in tried if setting.is_recipe}.values())
    try:
        return recommend(usable, wish, paper=paper), ""
    except RefusedError as error:
        return None, f"{error.reason}; {error.remedy}"
