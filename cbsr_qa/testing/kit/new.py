"""A package for a new plugin, from the templates beside this file: one of each kind, and what every package has."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from jinja2 import Environment, PackageLoader, StrictUndefined

from cbsr_qa.plugin import Kind, RefusedError
from cbsr_qa.plugin.discovery import Plugins

#: Names of folders and modules are made from it, and lines of code hold it.
_MAX_NAME_LENGTH: Final = 24
_NAME: Final = re.compile(r"[a-z][a-z0-9]*(-[a-z][a-z0-9]*)*")

#: File of the package → template; "{module}" is the importable name, "{kind}" the kind's.
_FILES: Final[Mapping[str, str]] = {
    "pyproject.toml": "pyproject.toml.j2",
    "README.md": "README.md.j2",
    "{module}/__init__.py": "init.py.j2",
    "{module}/{kind}.py": "{kind}.py.j2",
    "{module}/py.typed": "py.typed.j2",
    "tests/test_conformance.py": "test_conformance.py.j2",
}
#: Further files of a kind.
_MORE: Final[Mapping[Kind, Mapping[str, str]]] = {
    Kind.INSTRUMENT: {"{module}/emulator.py": "emulator.py.j2"},
    Kind.RECORDING: {"{module}/example.csv": "example.csv.j2"},
}


@dataclass(frozen=True, slots=True)
class NewPackage:
    """A package that was made.

    Parameters
    ----------
    folder : of the package.
    distribution, module : its names for pip and for import.
    files : written, relative to the folder.
    """

    kind: str
    name: str
    folder: Path
    distribution: str
    module: str
    files: tuple[str, ...]


def make_package(kind: Kind, name: str, plugins: Plugins, into: Path) -> NewPackage:
    """Write a package with one plugin that passes its own test.

    Parameters
    ----------
    name : of the plugin, lower-case words joined by hyphens; the package is called ``cbsr-qa-NAME``.
    plugins : the installed ones, whose names are taken.
    into : existing folder, in which the package's folder is made.

    Raises
    ------
    RefusedError
        If the name is not allowed or taken, or the folder exists; nothing is written then.
    """
    _check_name(kind, name, plugins)
    distribution = f"cbsr-qa-{name}"
    module, folder = distribution.replace("-", "_"), into / distribution
    _check_free(distribution, module, folder)
    words = {
        "kind": str(kind),
        "name": name,
        "distribution": distribution,
        "module": module,
        "variable": name.replace("-", "_"),
        "class_name": "".join(word.capitalize() for word in name.split("-")),
        "article": "an" if kind[0] in "aeiou" else "a",
    }
    texts = {
        file.format(**words): _TEMPLATES.get_template(template.format(**words)).render(words)
        for file, template in {**_FILES, **_MORE.get(kind, {})}.items()
    }
    _write(folder, texts)
    return NewPackage(str(kind), name, folder, distribution, module, tuple(texts))


_TEMPLATES: Final = Environment(
    loader=PackageLoader("cbsr_qa.testing.kit"),
    undefined=StrictUndefined,
    keep_trailing_newline=True,
    autoescape=False,
)


def _check_name(kind: Kind, name: str, plugins: Plugins) -> None:
    if not _NAME.fullmatch(name) or len(name) > _MAX_NAME_LENGTH:
        raise RefusedError(
            f"{name!r} cannot be the name of a plugin",
            remedy=f"use at most {_MAX_NAME_LENGTH} lower-case letters and digits; words are joined by hyphens "
            "and begin with a letter, e.g. peak-force",
        )
    if name in plugins.names(kind):
        (owner,) = {r.distribution for r in plugins.registrations(kind) if r.name == name}
        raise RefusedError(
            f"{kind} {name!r} is already registered by {owner}",
            remedy=f"choose another name; cbsr-qa plugins list --kind {kind} lists those that are taken",
        )


def _check_free(distribution: str, module: str, folder: Path) -> None:
    if not folder.parent.is_dir():
        raise RefusedError(f"{folder.parent} is not a folder", remedy="create it, or choose another with --into")
    if folder.exists() or folder.is_symlink():
        raise RefusedError(f"{folder} exists already", remedy="choose another name, or another folder with --into")
    if find_spec(module) is not None:
        raise RefusedError(f"a module {module} is installed already", remedy="choose another name")
    try:
        installed = version(distribution)
    except PackageNotFoundError:
        return
    raise RefusedError(f"{distribution} {installed} is installed already", remedy="choose another name")


def _write(folder: Path, texts: Mapping[str, str]) -> None:
    """Write all files or none: into a folder of another name, which is renamed at the end."""
    try:
        with TemporaryDirectory(dir=folder.parent, prefix=f".{folder.name}-") as temporary:
            made = Path(temporary) / folder.name
            for name, text in texts.items():
                file = made / name
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_text(text, encoding="utf-8")
            made.rename(folder)
    except OSError as error:
        raise RefusedError(
            f"{folder} cannot be written: {error.strerror or error}", remedy="choose another folder with --into"
        ) from error
