"""``cbsr-qa frontier``: what accuracy costs in time, on both clocks, and the setting to take."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from os import cpu_count
from pathlib import Path
from typing import Any

import cbsr_qa
from cbsr_qa.app.frontier_files import WRITTEN_BY, check_recipe
from cbsr_qa.app.frontier_runs import station_seconds, the_bench
from cbsr_qa.config.paths import var_folder, writable_folder
from cbsr_qa.config.toml_text import toml_document
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.naming import check_encodable
from cbsr_qa.files import written_whole
from cbsr_qa.frontier.computer import computer_tasks, worth_their_time
from cbsr_qa.frontier.point import Clock, Point, Task
from cbsr_qa.frontier.recommend import Recommended, Wish, recommend
from cbsr_qa.frontier.setting import Setting
from cbsr_qa.frontier.station import PAPER, station_work
from cbsr_qa.frontier.station_points import document_of, station_points, tried_of, worth_the_station
from cbsr_qa.frontier.sweep import Documents, Kept, Work, worked_out

#: Of what is simulated and how it is judged: pieces of another version are worked out again.
_VERSION = 3
#: Pieces of work whose times count must not share a core with others.
_ALONE = 1


@dataclass(frozen=True, slots=True, eq=False)
class Frontier:
    """What a sweep found.

    Parameters
    ----------
    points, pareto : every setting, and whether it is worth its time.
    settings : of the station's points, by their index.
    recommended : None where only the computer's clock was asked for, or nothing met the wish.
    why_not : nothing was recommended; empty otherwise.
    quick : few settings and sensors.
    """

    points: tuple[Point, ...]
    pareto: tuple[bool, ...]
    settings: Mapping[int, Setting]
    recommended: Recommended | None
    why_not: str
    quick: bool

    def document(self, recipe: Path | None = None) -> dict[str, Any]:
        """Return what ``--json`` prints.

        Parameters
        ----------
        recipe : where the recommended setting was written as a recipe.
        """
        return {
            "quick": self.quick,
            "points": [one.document(pareto=on) for one, on in zip(self.points, self.pareto, strict=True)],
            "recommended": self._recommended(recipe),
        }

    def _recommended(self, recipe: Path | None) -> dict[str, Any]:
        if self.recommended is None:
            return {"setting": None, "why": self.why_not}
        return {
            "setting": dict(self.recommended.point.knobs),
            "accuracy": {name: one.document() for name, one in self.recommended.point.accuracy.items()},
            "station_s": self.recommended.point.station_s,
            "why": self.recommended.why,
            "recipe": None if recipe is None else str(recipe),
        }

    def write_recipe(self, path: Path) -> None:
        """Write the recommended setting as a recipe that ``cbsr-qa run`` takes.

        Raises
        ------
        RefusedError
            If there is none, the file cannot be written, or one is there that was not written so.
        """
        if self.recommended is None:
            raise RefusedError(f"there is no recipe to write: {self.why_not}")
        check_recipe(path)
        name = path.stem[:64] or "frontier"
        check_encodable("the recipe's name", name)
        comments = (
            f"{WRITTEN_BY} {cbsr_qa.__version__}: {self.recommended.why}.",
            f"Simulated: {_said(self.recommended.point)}.",
            "A setting is as good as the simulation it was found in: check it on sensors of your own.",
        )
        text = toml_document(self.recommended.setting.recipe(the_bench().base, name), comments)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with written_whole(path) as file:
                file.write(text.encode())
        except OSError as error:
            raise RefusedError(f"{path} cannot be written: {error.strerror or error}") from error


def frontier(
    clocks: Sequence[Clock],
    wish: Wish,
    *,
    quick: bool = False,
    fresh: bool = False,
    tell: Callable[[int, int, str], None] = lambda done, of, what: None,
    processes: int | None = None,
    folder: Path | None = None,
) -> Frontier:
    """Sweep what was asked for, and choose.

    Finished pieces are kept in ``frontier/`` of the var folder: a sweep that was stopped goes on where it was.

    Parameters
    ----------
    fresh : forget what was kept.
    processes : at once, for simulations; times of the computer are always measured one after the other.

    Raises
    ------
    ConfigError, StoreError
        If the folder cannot be written to, or holds something else.
    """
    where = writable_folder((folder or var_folder()) / "frontier")
    points: list[Point] = []
    settings: dict[int, Setting] = {}
    pareto: list[bool] = []
    if Clock.STATION in clocks:
        tried = _station(_kept(where / "station.jsonl", fresh), quick, tell, processes)
        settings = {index: setting for index, (setting, _) in enumerate(tried)}
        points += [point for _, point in tried]
        pareto += worth_the_station(points)
    if Clock.COMPUTER in clocks:
        measured = _computer(_kept(where / "computer.jsonl", fresh), quick, tell)
        points += measured
        pareto += worth_their_time(measured)
    recommended, why = _recommended([(settings[k], points[k]) for k in settings], wish)
    return Frontier(tuple(points), tuple(pareto), settings, recommended, why, quick)


def _kept(path: Path, fresh: bool) -> Kept:
    if fresh:
        path.unlink(missing_ok=True)
    return Kept(path)


def _station(
    kept: Kept, quick: bool, tell: Callable[[int, int, str], None], processes: int | None
) -> list[tuple[Setting, Point]]:
    work = [
        Work(f"station {_VERSION}/{cbsr_qa.__version__}/{key}", what, partial(_tried, run))
        for key, what, run in station_work(the_bench(), quick=quick)
    ]
    count = min(2, cpu_count() or 1) if processes is None else processes
    found = worked_out(work, kept, tell, processes=count)
    trials = [tried_of(document) for documents in found.values() for document in documents]
    return station_points(trials, _seconds)


def _computer(kept: Kept, quick: bool, tell: Callable[[int, int, str], None]) -> list[Point]:
    tasks = computer_tasks(quick=quick)
    work = [Work(task.key, task.what, partial(_measured, task)) for task in tasks]
    found = worked_out(work, kept, tell, processes=_ALONE)
    return [Point.from_document(document) for documents in found.values() for document in documents]


def _tried(run: Callable[[], list[Any]]) -> Documents:
    return [document_of(tried) for tried in run()]


def _measured(task: Task) -> Documents:
    return [task.run().document()]


@lru_cache(maxsize=256)
def _seconds(setting: Setting) -> float:
    return station_seconds(setting.recipe(the_bench().base, "frontier"), setting.frame_period_s)


def _recommended(tried: Sequence[tuple[Setting, Point]], wish: Wish) -> tuple[Recommended | None, str]:
    if not tried:
        return None, "only the computer's clock was swept"
    paper = next((point for setting, point in tried if setting == PAPER), None)
    usable = list({setting: (setting, point) for setting, point in tried if setting.is_recipe}.values())
    try:
        return recommend(usable, wish, paper=paper), ""
    except RefusedError as error:
        return None, f"{error.reason}; {error.remedy}"


def _said(point: Point) -> str:
    force = point.accuracy["force_error"]
    stderr = "" if force.stderr is None else f" ± {force.stderr:.3f}"
    return (
        f"force error {force.value:.3f}{stderr} N over {point.seeds} sensors, {(point.station_s or 0) / 60:.0f} min"
    )
