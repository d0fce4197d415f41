"""Quasi-static and relaxation fits, settling, conductance map, force, the calibration file.

Whoever builds a sensor into something needs three names of it: ``from cbsr_qa.calibrate import Calibration, Flag,
ForceStream``.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cbsr_qa.calibrate.force import Flag
    from cbsr_qa.calibrate.runtime import Calibration
    from cbsr_qa.calibrate.tracking import ForceStream

__all__ = ["Calibration", "Flag", "ForceStream"]

_IN = {"Calibration": "runtime", "Flag": "force", "ForceStream": "tracking"}


def __getattr__(name: str) -> Any:
    # Loaded where they are asked for: other parts of this package are imported far more often, and without HDF5.
    if name in _IN:
        return getattr(import_module(f"{__name__}.{_IN[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
