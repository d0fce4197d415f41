"""Names that a robot imports from :mod:`cbsr_qa.calibration`: a calibration, read and applied to frames."""
# ruff: noqa: PLC0414 - "X as X" marks a re-export

from cbsr_qa.calibration.force.inverse import Flag as Flag
from cbsr_qa.calibration.loading import load_calibration as load_calibration
from cbsr_qa.calibration.runtime.calibration import Calibration as Calibration
from cbsr_qa.calibration.runtime.estimator import Estimator as Estimator, Touches as Touches
from cbsr_qa.calibration.runtime.press_calibration import PressCalibration as PressCalibration
from cbsr_qa.calibration.runtime.pressure import PressureMap as PressureMap
from cbsr_qa.calibration.runtime.tracking import ForceStream as ForceStream
from cbsr_qa.domain.errors import CbsrError as CbsrError
from cbsr_qa.domain.readings.loads import Indenter as Indenter
