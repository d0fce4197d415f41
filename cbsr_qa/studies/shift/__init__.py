"""What was tested: runs, sensors, and the yield of a shift."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .lists import (
        LATEST_RUNS as LATEST_RUNS,
        ListRequest as ListRequest,
        RunEntry as RunEntry,
        RunList as RunList,
        RunPage as RunPage,
        SensorList as SensorList,
        list_request as list_request,
        list_runs as list_runs,
        list_sensors as list_sensors,
        run_pages as run_pages,
        sensor_runs as sensor_runs,
        trust_counts as trust_counts,
        trust_notes as trust_notes,
    )
    from .report import (
        counts_words as counts_words,
        exit_code as exit_code,
        runs_csv as runs_csv,
        runs_outcome as runs_outcome,
        sensors_csv as sensors_csv,
        sensors_outcome as sensors_outcome,
        table_cell as table_cell,
        yield_words as yield_words,
    )
    from .summary import (
        local_day as local_day,
        shift_summary as shift_summary,
    )

door(__name__, __file__)
