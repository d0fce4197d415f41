"""Hard cases, by area."""

from importlib import import_module
from typing import Final

from cbsr_qa.studies.hard_cases.case import HardCase

#: Modules of cases, in the order of display.
_MODULES: Final = (
    *("forward", "forward_exact", "forward_loads", "readings", "reconstruction", "smoothness", "imaging"),
    *(
        "geometry",
        "relaxation",
        "calibration",
        "batch",
        "decisions",
        "loads",
        "time",
        "statistics",
        "comparison",
        "uncertainty",
    ),
)


def all_cases() -> tuple[HardCase, ...]:
    """Every case, in order of area."""
    areas = (import_module(f"{__name__}.{name}").AREA for name in _MODULES)
    return tuple(case for area in areas for case in area.cases)
