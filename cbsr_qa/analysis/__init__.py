"""Analysis of stored frames: measurements and a verdict, as pure functions of data and plugins."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .evaluate import (
        Conclusion as Conclusion,
        ask as ask,
        calibrated as calibrated,
        evaluate_run as evaluate_run,
        judge as judge,
        judge_again as judge_again,
    )
    from .recording_files import (
        FORMAT as FORMAT,
        SIGNATURE as SIGNATURE,
        read_recording as read_recording,
        recording_file as recording_file,
        write_recording as write_recording,
    )
    from .ring import RING as RING, check_ring as check_ring, fit_ring as fit_ring
    from .strip_cycles import characterise_run as characterise_run
    from .strip_measurements import measure_characterisation as measure_characterisation
    from .verification import Verification as Verification, verify_calibration as verify_calibration

door(__name__, __file__)
