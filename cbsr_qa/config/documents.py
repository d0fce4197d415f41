"""Finding and reading configuration files: by path or by the name of a shipped one."""

import math
import re
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from difflib import get_close_matches
from enum import Enum
from importlib.resources import files
from pathlib import Path
from typing import Any

from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.system.foreign import UnfitFileError, read_foreign
from cbsr_qa.system.words import echo, printable

#: Largest file [B]: more than any configuration; a recording given by mistake is not read into memory.
LARGEST_FILE_BYTES = 1_000_000
#: Most parts of a dotted key; parsing time grows with their square, and no key here has more than four.
MOST_KEY_PARTS = 50
#: Place where every key is described, in words: an installed package has no pages.
REFERENCE = 'the page "Configuration" of the documentation'

_TOO_DEEP = re.compile(rf"""(?<![\w"'.-])(?:[\w"'-]++\s*+\.\s*+){{{MOST_KEY_PARTS}}}""")
#: A key whose value is a number with a decimal comma.
_DECIMAL_COMMA = re.compile(r"(?m)^[ \t]*[\w-]{1,64}[ \t]*=[ \t]*([+-]?\d{1,20}),(\d{1,20})(?=[ \t]*(?:#|$))")


class DocumentKind(Enum):
    """What a configuration file describes: (name in messages, folder among the shipped files, the table it needs).

    A file may hold what another kind needs (a recipe its limits): it is of the first kind here whose table it has.
    """

    STATION = ("station", "", "station")
    RECIPE = ("recipe", "recipes", "recipe")
    SENSOR_TYPE = ("sensor type", "sensor_types", "sensor_type")
    MATERIAL = ("material", "materials", "material")
    SCENE = ("scene", "scenes", "scene")
    GAUGE_STUDY = ("gauge study", "studies", "study")
    LIMITS = ("limits", "limits", "limits_version")
    REFERENCES = ("reference values", "references", "reference")
    STANDARDS = ("standards", "standards", "standards")
    CERTIFICATE = ("certificate settings", "certificates", "certificate")

    @property
    def noun(self) -> str:
        return self.value[0]

    @property
    def folder(self) -> str:
        """Folder of the shipped files of this kind, below ``cbsr_qa._stations``."""
        return self.value[1]

    @property
    def table(self) -> str:
        """The top-level table that every file of this kind has, and by which it is known."""
        return self.value[2]


@dataclass(frozen=True, slots=True, eq=False)
class Document:
    """A configuration file as read, not yet checked.

    Parameters
    ----------
    kind : kind of the file.
    label : its name in messages: a path, or ``shipped station 'simulated'``.
    path : path of a user's file; None for shipped files and for configurations restored from a run.
    text : source text; empty where it was restored.
    data : parsed content.
    """

    kind: DocumentKind
    label: str
    path: Path | None
    text: str
    data: Mapping[str, Any]

    @property
    def folder(self) -> Path | None:
        """Folder that is searched first for this file's references."""
        return None if self.path is None else self.path.parent


def list_shipped(kind: DocumentKind) -> tuple[str, ...]:
    """Return the names of the shipped files of one kind, sorted."""
    folder = files("cbsr_qa._stations").joinpath(kind.folder)
    if not folder.is_dir():
        return ()
    return tuple(sorted(f.name.removesuffix(".toml") for f in folder.iterdir() if f.name.endswith(".toml")))


def open_document(kind: DocumentKind, name_or_path: str | Path, *, near: Path | None = None) -> Document:
    """Find and parse a configuration file.

    Parameters
    ----------
    name_or_path : a path (it has a folder or ends in ``.toml``) or the name of a shipped file.
    near : folder of the file that refers to it; searched before the shipped files.

    Raises
    ------
    ConfigError
        If there is no such file (lists the shipped names), it cannot be read, or it is not TOML (with the line).
    """
    path = _path_of(name_or_path, near)
    if path is not None:
        return _parse(kind, printable(str(path)), path, _read(kind, path))
    name = str(name_or_path)
    if name not in list_shipped(kind):
        raise _unknown(kind, name)
    source = files("cbsr_qa._stations").joinpath(kind.folder, f"{name}.toml")
    return _parse(kind, f"shipped {kind.noun} {name!r}", None, source.read_text(encoding="utf-8"))


def reference_path(name: str, near: Path | None) -> Path | None:
    """Return the path of a reference next to the user's file that states it; None if it does not exist."""
    if near is None:
        return None
    for candidate in (near / name, near / f"{name}.toml"):
        if candidate.suffix == ".toml" and _is_file(candidate):
            return candidate
    return None


def _path_of(name_or_path: str | Path, near: Path | None) -> Path | None:
    """Return the path that a name means, even if it does not exist; None for the name of a shipped file."""
    if isinstance(name_or_path, Path):
        return name_or_path
    if path := reference_path(name_or_path, near):
        return path
    if name_or_path.endswith(".toml") or "/" in name_or_path or "\\" in name_or_path:
        return (near or Path()) / name_or_path
    return None


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # a name too long for the file system, or with a NUL in it
        return False


def _unknown(kind: DocumentKind, name: str) -> ConfigError:
    shipped = list_shipped(kind)
    close_matches = get_close_matches(name, shipped, n=1)
    hint = f"did you mean {close_matches[0]!r}? " if close_matches else ""
    remedy = []
    if name and _is_file(Path(f"{name}.toml")):
        remedy.append(f"for the file in this folder give {name}.toml")
    remedy += [
        f"{echo(name)} is a shipped {other_kind.noun}"
        for other_kind in DocumentKind
        if name in list_shipped(other_kind)
    ]
    remedy.append(f"shipped: {', '.join(shipped) or 'none'}; or give the path of a .toml file")
    return ConfigError(f"there is no {kind.noun} named {echo(name)}", remedy=hint + "; ".join(remedy))


def _read(kind: DocumentKind, path: Path) -> str:
    exists = False
    with suppress(OSError, ValueError):
        exists = path.exists()
    if not exists:
        shipped = f"; or give a shipped name: {names}" if (names := ", ".join(list_shipped(kind))) else ""
        raise ConfigError(
            f"{kind.noun} file {echo(str(path), 200)} does not exist", remedy=f"check its name and folder{shipped}"
        )
    label = printable(str(path))
    try:
        return read_foreign(path, LARGEST_FILE_BYTES).decode("utf-8-sig")
    except UnfitFileError as error:
        raise ConfigError(
            f"{kind.noun} file {label} cannot be read: {error.strerror}", remedy=f"give the {kind.noun}'s TOML file"
        ) from error
    except UnicodeDecodeError as error:
        raise ConfigError(
            f"{label} is not a text file: byte {error.start} is not UTF-8",
            remedy=f"give the {kind.noun}'s TOML file, saved as UTF-8",
        ) from error
    except OSError as error:
        raise ConfigError(f"{kind.noun} file {label} cannot be read: {error.strerror}") from error


def _parse(kind: DocumentKind, label: str, path: Path | None, text: str) -> Document:
    if long_key := _TOO_DEEP.search(text):
        line = text.count("\n", 0, long_key.start()) + 1
        raise ConfigError(
            f"{label} line {line}: a key of more than {MOST_KEY_PARTS} parts",
            remedy=f"{REFERENCE} lists every key",
        )
    try:
        data = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # no TOML, or a whole number of thousands of digits
        reason = str(error).partition("; use sys.")[0]
        remedy = "see https://toml.io for the syntax"
        if comma := _DECIMAL_COMMA.search(text):
            remedy = f"write {comma[1]}.{comma[2]} with a decimal point in {comma[0]!r}"
        raise ConfigError(f"{label} is not valid TOML: {reason}", remedy=remedy) from error
    actual_kind = next((other_kind for other_kind in DocumentKind if other_kind.table in data), kind)
    within_others = kind in (DocumentKind.LIMITS, DocumentKind.REFERENCES)
    if actual_kind is not kind and (kind.table not in data or within_others):
        raise ConfigError(
            f"{label} is a {actual_kind.noun} file, not a {kind.noun} file", remedy=f"give a {kind.noun} file here"
        )
    return Document(kind, label, path, text, data)


def find_not_finite(data: object, path: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """Yield the key paths of numbers that are not finite: TOML allows ``nan`` and ``inf``, no quantity here does."""
    if isinstance(data, Mapping):
        for key, value in data.items():
            yield from find_not_finite(value, (*path, key))
    elif isinstance(data, list):
        for index, value in enumerate(data):
            yield from find_not_finite(value, (*path, index))
    elif isinstance(data, float) and not math.isfinite(data):
        yield path
