"""What a plugin imports: the names of :mod:`cbsr_qa.plugin.api`, loaded together when one is first used.

A command that lists plugins, or loads the modules below, does not wait for them.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cbsr_qa.plugin.api import *  # noqa: F403 - its list is the only one


def __getattr__(name: str) -> Any:
    if name.startswith("_") and name != "__all__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return __dir__() if name == "__all__" else getattr(import_module(f"{__name__}.api"), name)


def __dir__() -> list[str]:
    return [name for name in vars(import_module(f"{__name__}.api")) if not name.startswith("_")]
