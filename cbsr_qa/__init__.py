"""Calibration and quality assurance of soft pressure sensors read by electrical impedance tomography.

``import cbsr_qa as qa`` offers notebooks and scripts what :mod:`cbsr_qa.calibration` and :mod:`cbsr_qa.interface`
list, loaded when a name is first used: importing it loads no numpy, no database, no plugin. What a plugin author
needs is in :mod:`cbsr_qa.plugin`.
"""

from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cbsr_qa.calibration.api import *  # noqa: F403 - their lists are the only ones
    from cbsr_qa.interface import *  # noqa: F403

__version__ = "0.1.0"
#: A robot has what the first needs; the second also needs the database, the report and the plugins.
_DOORS = ("cbsr_qa.calibration.api", "cbsr_qa.interface")


def __getattr__(name: str) -> Any:
    if name == "__all__":
        return __dir__()
    missing = ""
    if not name.startswith("_"):
        for door in _DOORS:
            offer, absent = _list_offer(door)
            if name in offer:
                return offer[name]
            missing = missing or absent
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}{missing}")


def __dir__() -> list[str]:
    return sorted(name for door in _DOORS for name in _list_offer(door)[0])


def _list_offer(door: str) -> tuple[dict[str, Any], str]:
    """Return what a package imports to be used by others: no modules, which importing them adds to it.

    Where something that it needs is not installed, as in a robot, it offers nothing, and the second says why.
    """
    try:
        members = vars(import_module(door)).items()
    except ModuleNotFoundError as error:
        if (error.name or "").startswith(__name__):
            raise
        return {}, f" beside {door}, which needs {error.name}: install cbsr-qa with what it requires"
    offered = {
        name: value for name, value in members if not name.startswith("_") and not isinstance(value, ModuleType)
    }
    return offered, ""
