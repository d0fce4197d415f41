"""Learning from a sensor's own loads: fits, the sheet's response, force, and the issued file."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .issue import issue_calibration as issue_calibration
    from .runtime import Calibration as Calibration, Flag as Flag, ForceStream as ForceStream

door(__name__, __file__)
