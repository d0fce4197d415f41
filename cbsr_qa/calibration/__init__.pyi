from .issue import issue_calibration as issue_calibration
from .runtime import Calibration as Calibration, Flag as Flag, ForceStream as ForceStream
