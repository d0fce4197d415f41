"""Which software made a number.

Which plugins there are.
"""

import platform
import re
from difflib import get_close_matches
from importlib.metadata import PackageNotFoundError, distribution, version
from typing import Final

import cbsr_qa
from cbsr_qa.domain.errors import PluginError
from cbsr_qa.plugin.discovery import Plugins
from cbsr_qa.plugin.hooks import Kind

#: Numerical libraries that results depend on.
_NUMERICS: Final = ("numpy", "scipy", "scikit-image", "h5py", "sqlalchemy")
#: In place of the version of a library that is not there.
NOT_INSTALLED: Final = "not installed"
#: Libraries for communication with instruments.
_LINKS: Final = ("pyserial", "pyvisa", "pyvisa-py")


def software_versions(plugins: Plugins) -> tuple[tuple[str, str], ...]:
    """Versions of this package, of every distribution that registered a plugin, of Python and the libraries used.

    Returns
    -------
    (distribution, version) pairs: ours first, then plugins and libraries by name.
    """
    theirs = {(r.distribution, r.version) for r in plugins.registrations() if r.distribution != "cbsr-qa"}
    python = ("python", platform.python_version())
    return (("cbsr-qa", cbsr_qa.__version__), *sorted(theirs), python, *_installation_versions())


def _installation_versions() -> tuple[tuple[str, str], ...]:
    versions = []
    for name in (*_NUMERICS, *_LINKS):
        try:
            # Ten times as fast as parsing all of the metadata.
            stated = re.search(r"^Version: (\S+)\s*$", distribution(name).read_text("METADATA") or "", re.MULTILINE)
            versions.append((name, version(name) if stated is None else stated[1]))
        except PackageNotFoundError:
            versions.append((name, NOT_INSTALLED))
    return tuple(versions)


def kind_named(name: str | None) -> Kind | None:
    """Return the kind of plugin a user named, None for every kind.

    Raises
    ------
    PluginError
        If there is no such kind.
    """
    if name is None:
        return None
    try:
        return Kind(name)
    except ValueError:
        kinds = [str(kind) for kind in Kind]
        near = get_close_matches(name, kinds, n=1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        raise PluginError(f"there is no kind of plugin {name!r}", remedy=f"{hint}kinds: {', '.join(kinds)}") from None
