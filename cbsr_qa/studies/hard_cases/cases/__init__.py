"""Hard cases, by area."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from . import (
        calibration as calibration,
        forward as forward,
        forward_exact as forward_exact,
        forward_loads as forward_loads,
        geometry as geometry,
        imaging as imaging,
        loads as loads,
        readings as readings,
        reconstruction as reconstruction,
        relaxation as relaxation,
        smoothness as smoothness,
        statistics as statistics,
        time as time,
    )

door(__name__, __file__)
