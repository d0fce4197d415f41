"""Learning from a sensor's own loads, and calibrations in use.

The names below are what a robot needs; they load numpy, scipy and h5py, and nothing else.
"""

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
from cbsr_qa.domain.readings.loads import Indenter as Indenter
