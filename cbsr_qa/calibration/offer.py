"""What a robot imports from :mod:`cbsr_qa.calibration`: a calibration, read and applied to frames."""
# ruff: noqa: PLC0414 - the second name says that it is handed on

from cbsr_qa.calibration.force.inverse import Flag as Flag
from cbsr_qa.calibration.loading import (
    PressCalibration as PressCalibration,
    load_calibration as load_calibration,
    load_press_calibration as load_press_calibration,
)
from cbsr_qa.calibration.runtime.pressure import PressureMap as PressureMap
from cbsr_qa.calibration.runtime.runtime import Calibration as Calibration
from cbsr_qa.calibration.runtime.tracking import ForceStream as ForceStream
from cbsr_qa.domain.errors import CbsrError as CbsrError
