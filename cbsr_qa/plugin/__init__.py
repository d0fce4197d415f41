"""What a plugin imports: the names of :mod:`cbsr_qa.plugin.api`, loaded together when one is first used, and links.

A command that lists plugins, or loads the modules below, does not wait for them.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from cbsr_qa.plugin.api import *  # noqa: F403 - its list is the only one
    from cbsr_qa.plugin.links.serial_link import SerialLink as SerialLink

#: Modules of names that are loaded apart, since few plugins use them.
_APART: Final = {"SerialLink": "links.serial_link"}


def __getattr__(name: str) -> Any:
    if name.startswith("_") and name != "__all__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return __dir__() if name == "__all__" else getattr(import_module(f"{__name__}.{_APART.get(name, 'api')}"), name)


def __dir__() -> list[str]:
    return [*(name for name in vars(import_module(f"{__name__}.api")) if not name.startswith("_")), *_APART]
