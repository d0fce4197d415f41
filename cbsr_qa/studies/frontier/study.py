"""``cbsr-qa frontier``: what accuracy costs in time, on both clocks, and the setting to take.

Files that ``cbsr-qa frontier`` is asked for: refused before a sweep of minutes, not after it.
"""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from os import cpu_count
from pathlib import Path
from typing import Any, Final

import cbsr_qa
from cbsr_qa.config import toml_document, var_folder, writable_folder
from cbsr_qa.domain import RefusedError, check_encodable
from cbsr_qa.studies.frontier.computer import computer_tasks, worth_their_time
from cbsr_qa.studies.frontier.point import Clock, Point, Task
from cbsr_qa.studies.frontier.recommend import Recommended, Wish, recommend
from cbsr_qa.studies.frontier.runs import (
    document_of,
    station_points,
    station_seconds,
    the_bench,
    tried_of,
    worth_the_station,
)
from cbsr_qa.studies.frontier.setting import Setting
from cbsr_qa.studies.frontier.station import PAPER, station_work
from cbsr_qa.studies.sweep import Documents, Kept, Work, worked_out
from cbsr_qa.system import written_whole

#: First words of every recipe that is written here; what begins otherwise is somebody's own.
WRITTEN_BY: Final = "Written by cbsr-qa frontier"


@dataclass(frozen=True, slots=True)
class Files:
    """Where to write; None for what is not wanted.

    Parameters
    ----------
    recipe : the recommended setting, TOML.
    output, png : page, and picture of the station's frontier.
    """

    recipe: Path | None = None
    output: Path | None = None
    png: Path | None = None

    def check(self, clocks: Sequence[Clock]) -> None:
        """Make sure that all can be written, and that nothing of somebody else's is written over.

        Raises
        ------
        RefusedError
            If a name is no file's of its kind, a folder cannot be written to, two are the same, or there will be
            nothing to write because the station's clock is not swept.
        """
        if self.png is not None:
            check_png(self.png)
        if self.recipe is not None:
            check_recipe(self.recipe)
        wanted = dict(self._wanted())
        for option, path in wanted.items():
            _check_place(option, path)
        if len({path.absolute() for path in wanted.values()}) < len(wanted):
            raise RefusedError(f"{', '.join(wanted)} name the same file", remedy="give each a name of its own")
        for option in ("--recipe", "--png"):
            if option in wanted and Clock.STATION not in clocks:
                what = "recipe to write" if option == "--recipe" else "force error to draw"
                raise RefusedError(f"{option}: there is no {what}", remedy="sweep the station's clock")

    def _wanted(self) -> Iterator[tuple[str, Path]]:
        for option, path in (("--recipe", self.recipe), ("--output", self.output), ("--png", self.png)):
            if path is not None:
                yield option, path


def check_png(path: Path) -> None:
    """Refuse a name that is not one of a PNG picture."""
    if path.suffix.lower() != ".png":
        raise RefusedError(f"{path} is no name of a PNG picture", remedy="let it end in .png")


def check_recipe(path: Path) -> None:
    """Refuse a name that ``run --recipe`` would not take for a file's, and a file that was not written here."""
    if path.suffix != ".toml":
        raise RefusedError(f"{path} is no name of a recipe file", remedy="let it end in .toml")
    try:
        first = path.read_bytes()[:100]
    except FileNotFoundError:
        return
    except OSError as error:
        raise RefusedError(f"{path} cannot be written: {error.strerror or error}") from error
    if not first.startswith(f"# {WRITTEN_BY}".encode()):
        raise RefusedError(
            f"{path} exists already, and cbsr-qa frontier did not write it",
            remedy="name another file, or remove it first",
        )


def _check_place(option: str, path: Path) -> None:
    """A file can be made there: its folder, or the nearest one above that is there, can be written to."""
    try:
        if path.is_dir():
            raise RefusedError(f"{option}: {path} is a folder", remedy="name a file in it")
        above = next(folder for folder in path.absolute().parents if folder.exists())
    except OSError as error:
        raise RefusedError(f"{option}: {path} cannot be written: {error.strerror or error}") from error
    if not above.is_dir():
        raise RefusedError(f"{option}: {path} cannot be written: {above} is no folder", remedy="name another file")
    if not os.access(above, os.W_OK | os.X_OK):
        raise RefusedError(f"{option}: {path} cannot be written: folder {above} cannot be written to")


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
