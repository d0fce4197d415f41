"""A calibration in use: frames in, newtons out. Needs numpy, scipy and h5py alone."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .faults import FaultFinder as FaultFinder, FrameFaults as FrameFaults
    from .force import (
        LEFT_OUT as LEFT_OUT,
        NO_FORCE as NO_FORCE,
        Flag as Flag,
        ForceInverse as ForceInverse,
        Forces as Forces,
        least_force_N as least_force_N,
        map_tables as map_tables,
    )
    from .interpolation import interpolate as interpolate
    from .pressed_place import PressedPlace as PressedPlace, row_readings as row_readings
    from .runtime import Calibration as Calibration
    from .settling_forces import SettlingForces as SettlingForces
    from .template_matching import (
        Matches as Matches,
        TemplateFilter as TemplateFilter,
        add_scatter as add_scatter,
    )
    from .tracking import ForceStream as ForceStream

door(__name__, __file__)
