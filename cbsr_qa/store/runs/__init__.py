"""Runs: stored, read and resumed."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from . import (
        archiving as archiving,
        attendance as attendance,
        begun as begun,
        live as live,
        outcomes as outcomes,
        runs as runs,
        sessions as sessions,
    )
    from .archiving import ArchivedRun as ArchivedRun
    from .codec import (
        decoded_indenter as decoded_indenter,
        decoded_material as decoded_material,
        decoded_sensor_type as decoded_sensor_type,
        encoded as encoded,
        frame_block as frame_block,
        frame_values as frame_values,
        sample_block as sample_block,
        sample_values as sample_values,
    )
    from .journal import Journal as Journal
    from .live import (
        ChangeNotice as ChangeNotice,
        LivePhase as LivePhase,
        RunLook as RunLook,
        RunTail as RunTail,
    )
    from .many_blocks import (
        check_many_frames as check_many_frames,
        check_many_samples as check_many_samples,
    )
    from .outcomes import NoRunError as NoRunError, latest_result as latest_result
    from .rows import (
        current_state as current_state,
        run_row as run_row,
    )
    from .sessions import (
        IncompleteRun as IncompleteRun,
        counts as counts,
        incomplete_runs as incomplete_runs,
        latest_id as latest_id,
        runs_without_result as runs_without_result,
    )

door(__name__, __file__)
