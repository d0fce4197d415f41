"""What is checked: plugins by name, or those of a package's folder, which need not be installed."""

import importlib
import sys
import tomllib
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

from cbsr_qa.plugin import Kind, PluginError
from cbsr_qa.plugin.discovery import Plugins, discover
from cbsr_qa.system.foreign import read_foreign

_GROUP = "cbsr_qa"
_MAX_PROJECT_BYTES = 2**20


@dataclass(frozen=True, slots=True)
class Targets:
    """Plugins to check, by kind and name, and all plugins beside which they are checked."""

    plugins: Plugins
    names: tuple[tuple[Kind, str], ...]


def targets_of(asked: str | None, kind: Kind | None = None) -> Targets:
    """Find plugins by the name of one, or the folder of a package.

    Parameters
    ----------
    asked : a name; what is a folder, or has a slash, is a folder. None for all plugins of other packages than ours.
    kind : only plugins of this kind; None for all.

    Raises
    ------
    PluginError
        If nothing is registered under the name, or by another package, or the package of the folder cannot be
        loaded, with the reason.
    """
    if asked is None:
        return _list_others(discover(), kind)
    folder = Path(asked)
    if folder.is_dir() or "/" in asked:
        return _list_in_folder(folder, kind)
    plugins = discover()
    names = tuple((each, asked) for each in Kind if kind in (None, each) and asked in plugins.names(each))
    if not names:
        raise plugins.unknown(kind, asked)
    return Targets(plugins, names)


def _list_others(plugins: Plugins, kind: Kind | None) -> Targets:
    others = [one for one in plugins.registrations(kind) if one.distribution != "cbsr-qa"]
    if not others:
        raise PluginError(
            "no plugin of another package is installed", remedy="name a plugin, or the folder of a package"
        )
    return Targets(plugins, tuple((one.kind, one.name) for one in others))


def _list_in_folder(folder: Path, kind: Kind | None) -> Targets:
    file = folder / "pyproject.toml"
    project = _project(file)
    distribution, version = str(project.get("name", "unnamed")), str(project.get("version", "unknown"))
    points = project.get("entry-points", {}).get(_GROUP, {})
    if not points:
        raise PluginError(
            f"{file} has no table [project.entry-points.{_GROUP}], so it adds no plugin",
            remedy=f'add one line to it that names a module: {distribution} = "{distribution.replace("-", "_")}"',
        )
    # An installed copy stays out: the one in the folder is checked.
    plugins = discover(blocked=[distribution])
    sys.path.insert(0, str((folder / "src" if (folder / "src").is_dir() else folder).resolve()))
    importlib.invalidate_caches()
    for name, module in points.items():
        plugins.load(EntryPoint(name, str(module), _GROUP), distribution, version)
    for failure in plugins.failures:
        if failure.distribution == distribution:
            raise PluginError(f"{file}: {failure}", remedy="repair the module that the entry point names")
    names = tuple((each.kind, each.name) for each in plugins.registrations(kind) if each.distribution == distribution)
    if not names:
        of_kind = "plugin" if kind is None else f"{kind} plugin"
        raise PluginError(f"{folder} registers no {of_kind}", remedy="call register in its hook cbsr_register")
    return Targets(plugins, names)


def _project(file: Path) -> dict[str, Any]:
    try:
        document = tomllib.loads(read_foreign(file, _MAX_PROJECT_BYTES).decode())
    except OSError as error:
        raise PluginError(
            f"{file} cannot be read: {error.strerror or error}",
            remedy="give the name of an installed plugin, or the folder of a package with a pyproject.toml",
        ) from error
    except ValueError as error:
        raise PluginError(f"{file} is not TOML: {error}", remedy="correct it and try again") from error
    project = document.get("project")
    if not isinstance(project, dict):
        raise PluginError(f"{file} has no table [project]", remedy="describe the package there")
    return project
