"""``import cbsr_qa as qa``: what notebooks and scripts may rely on, re-exported by :mod:`cbsr_qa`."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .analysing import Analysis as Analysis, analyse as analyse
    from .calibrations import (
        Calibration as Calibration,
        Flag as Flag,
        ForceStream as ForceStream,
        PressureMap as PressureMap,
        load_calibration as load_calibration,
    )
    from .comparing import compare as compare
    from .database import Database as Database, open_database as open_database
    from .images import Images as Images, image as image
    from .presses import PressCalibration as PressCalibration, load_press_calibration as load_press_calibration
    from .result import CbsrError as CbsrError, Result as Result
    from .running import run as run
    from .scenes import Scene as Scene, simulate_scene as simulate_scene
    from .stored_run import Run as Run
    from .streaming import stream as stream

door(__name__, __file__)
