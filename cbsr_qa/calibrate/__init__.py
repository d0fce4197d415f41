"""Quasi-static and relaxation fits, settling, conductance map, force, the calibration file.

Whoever builds a sensor into something needs one name of it: ``from cbsr_qa.calibrate import Calibration``.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cbsr_qa.calibrate.runtime import Calibration

__all__ = ["Calibration"]


def __getattr__(name: str) -> Any:
    # Loaded where it is asked for: other parts of this package are imported far more often, and without HDF5.
    if name == "Calibration":
        from cbsr_qa.calibrate.runtime import Calibration

        return Calibration
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
