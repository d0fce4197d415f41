"""Calibration files: made from presses, shown, checked, signed, converted, and applied to recordings."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .apply import (
        AppliedCalibration as AppliedCalibration,
        ApplyRequest as ApplyRequest,
        apply_calibration as apply_calibration,
        apply_outcome as apply_outcome,
        as_csv as as_csv,
        write_table as write_table,
    )
    from .apply_places import (
        AppliedPlaces as AppliedPlaces,
        PressedPlaces as PressedPlaces,
        apply_to_presses as apply_to_presses,
        issued_file as issued_file,
        of_presses as of_presses,
        pattern_of as pattern_of,
        places_csv as places_csv,
        places_outcome as places_outcome,
    )
    from .calibrate import PressesCalibrated as PressesCalibrated, calibrate_from_presses as calibrate_from_presses
    from .file import (
        Converted as Converted,
        export_calibration as export_calibration,
        read_any as read_any,
    )
    from .frame_scale import FrameScale as FrameScale, whole_readings as whole_readings
    from .page import show_calibration as show_calibration
    from .presses_shown import ShownPressCalibration as ShownPressCalibration
    from .shown import ShownCalibration as ShownCalibration
    from .signing import (
        NewKey as NewKey,
        SignedFile as SignedFile,
        SoundFile as SoundFile,
        make_key as make_key,
        sign_file as sign_file,
        verify_file as verify_file,
    )

door(__name__, __file__)
