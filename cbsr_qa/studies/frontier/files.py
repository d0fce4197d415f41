"""Output files of ``cbsr-qa frontier``, checked before a sweep of minutes rather than after it."""

import errno
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cbsr_qa
from cbsr_qa.config.text import toml_document
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.numbers import check_encodable
from cbsr_qa.report.tables import plural
from cbsr_qa.studies.frontier.point import TimeBasis
from cbsr_qa.studies.frontier.recommend import Recommendation
from cbsr_qa.system.files import write_atomically, writing
from cbsr_qa.system.foreign import open_foreign

#: First words of every recipe written here; files with another beginning are the user's own.
WRITTEN_BY: Final = "Written by cbsr-qa frontier"


@dataclass(frozen=True, slots=True)
class Files:
    """Where to write the recommended recipe, the page and the picture; None if not requested."""

    recipe: Path | None = None
    output: Path | None = None
    png: Path | None = None

    def check(self, clocks: Sequence[TimeBasis]) -> None:
        """Make sure that all files can be written, and that none of the user's own is overwritten.

        Raises
        ------
        RefusedError
            If a name has the wrong suffix, a folder cannot be written to, two names are equal, or there will be
            nothing to write because station time is not swept.
        """
        if self.png is not None and self.png.suffix.lower() != ".png":
            raise RefusedError(f"{self.png} is not the name of a PNG file", remedy="use a name ending in .png")
        if self.recipe is not None:
            check_recipe(self.recipe)
        options = {"--recipe": self.recipe, "--output": self.output, "--png": self.png}
        paths_by_option = {option: path for option, path in options.items() if path is not None}
        for option, path in paths_by_option.items():
            _check_place(option, path)
        if len({path.absolute() for path in paths_by_option.values()}) < len(paths_by_option):
            raise RefusedError(
                f"{', '.join(paths_by_option)} name the same file", remedy="give each a different name"
            )
        for option, missing_content in (("--recipe", "recipe to write"), ("--png", "force error to draw")):
            if option in paths_by_option and TimeBasis.STATION not in clocks:
                raise RefusedError(f"{option}: there is no {missing_content}", remedy="sweep the station's clock")


def check_recipe(path: Path) -> None:
    """Refuse a name that ``run --recipe`` would not take for a file, and a file not written here."""
    if path.suffix != ".toml":
        raise RefusedError(f"{path} is not the name of a recipe file", remedy="use a name ending in .toml")
    with writing(path):
        try:
            with open_foreign(path) as file:
                first_bytes = file.read(100)
        except FileNotFoundError:
            return
    if not first_bytes.startswith(f"# {WRITTEN_BY}".encode()):
        raise RefusedError(
            f"{path} exists already, and cbsr-qa frontier did not write it",
            remedy="name another file, or remove it first",
        )


def _check_place(option: str, path: Path) -> None:
    """Refuse a place where no file can be made: its folder, or the nearest existing parent, must be writable."""
    with writing(path):
        if path.is_dir():
            raise RefusedError(f"{option}: {path} is a folder", remedy="name a file in it")
        parent = next(folder for folder in path.absolute().parents if folder.exists())
        if not parent.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, f"{parent} is not a folder")
        if not os.access(parent, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, f"folder {parent} is not writable")


def write_recipe(recommended: Recommendation, path: Path) -> None:
    """Write the recommended setting as a recipe.

    RefusedError if no setting is recommended, or the file cannot be written, or this command did not write it.
    """
    if recommended.way is None or recommended.accuracy is None:
        raise RefusedError(f"there is no recipe to write: {recommended.why}")
    name = path.stem[:64] or "frontier"
    force, minutes = recommended.accuracy["force_error"], (recommended.station_s or 0) / 60
    stderr = "" if force.stderr is None else f" ± {force.stderr:.3f}"
    comments = (
        f"{WRITTEN_BY} {cbsr_qa.__version__}: {recommended.why}.",
        f"Simulated: mean force error of {plural(recommended.seeds, 'sensor')} {force.value:.3f}{stderr} N,"
        f" {minutes:.0f} min.",
        "A setting is as good as the simulation it was found in: check it on sensors of your own.",
    )
    write_document(path, recommended.way.recipe(name), comments)


def write_document(path: Path, recipe: Mapping[str, Any], comments: Sequence[str]) -> None:
    """Write a recipe with comments before it.

    RefusedError if its name cannot be written, the file cannot be written, or this command did not write it.
    """
    check_recipe(path)
    check_encodable("the recipe's name", recipe["recipe"]["name"])
    text = toml_document(recipe, comments)
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with write_atomically(path) as file:
            file.write(text.encode())
