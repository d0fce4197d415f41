"""Learning from a sensor's own loads, and calibrations in use.

The names of :mod:`cbsr_qa.calibration.api` are what a robot needs, loaded together when one is first used. They
load numpy, scipy and h5py, and nothing else.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cbsr_qa.calibration.api import *  # noqa: F403 - its list is the only one


def __getattr__(name: str) -> Any:
    if name.startswith("_") and name != "__all__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return __dir__() if name == "__all__" else getattr(import_module(f"{__name__}.api"), name)


def __dir__() -> list[str]:
    return [name for name in vars(import_module(f"{__name__}.api")) if not name.startswith("_")]
