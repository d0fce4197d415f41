"""Analysis of an unannotated recording: channels, noise, presses."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .analysis import (
        DEFAULT_RECONSTRUCTION as DEFAULT_RECONSTRUCTION,
        AnalysisChoices as AnalysisChoices,
        analyse_recording as analyse_recording,
    )
    from .images import (
        EventImages as EventImages,
        Sighting as Sighting,
        frames_around as frames_around,
        nearest_frames as nearest_frames,
    )
    from .imaging import nominal_disc as nominal_disc, sheet_for as sheet_for
    from .places import Place as Place
    from .press_files import (
        PressFiles as PressFiles,
        distinct_pairs as distinct_pairs,
        read_labelled_presses as read_labelled_presses,
        read_pressed_frames as read_pressed_frames,
    )
    from .reading import guarded as guarded, read_recording_file as read_recording_file, recognised as recognised
    from .ready import ReadyReadings as ReadyReadings, make_ready as make_ready
    from .tank import fitted_tank as fitted_tank

door(__name__, __file__)
