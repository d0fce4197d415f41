"""Calibration and quality assurance of soft pressure sensors read by electrical impedance tomography.

``import cbsr_qa as qa`` offers the names below to notebooks and scripts; importing it loads nothing heavy: no
scipy, no database, no plugin. What a plugin author needs is in :mod:`cbsr_qa.domain` (the words of the trade) and
:mod:`cbsr_qa.plugin` (what to implement, and how to be found).
"""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

__version__ = "0.1.0"

if TYPE_CHECKING:
    from .interface import (
        Analysis as Analysis,
        Calibration as Calibration,
        CbsrError as CbsrError,
        Database as Database,
        Flag as Flag,
        ForceStream as ForceStream,
        Images as Images,
        PressCalibration as PressCalibration,
        PressureMap as PressureMap,
        Result as Result,
        Run as Run,
        Scene as Scene,
        analyse as analyse,
        compare as compare,
        image as image,
        load_calibration as load_calibration,
        load_press_calibration as load_press_calibration,
        open_database as open_database,
        run as run,
        simulate_scene as simulate_scene,
        stream as stream,
    )

door(__name__, __file__)
