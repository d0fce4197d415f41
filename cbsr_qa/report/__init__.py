"""From results and sections to pages."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .document import (
        IF_GIVEN as IF_GIVEN,
        Refusal as Refusal,
        json_document as json_document,
        json_schema as json_schema,
    )
    from .gate import gate_blocks as gate_blocks, gate_table as gate_table, gate_words as gate_words
    from .page import answer as answer, recording_page as recording_page, run_page as run_page
    from .render import (
        check_replaceable as check_replaceable,
        render_fragment as render_fragment,
        render_recording as render_recording,
        render_run as render_run,
        render_sections as render_sections,
        report_name as report_name,
        write_report as write_report,
    )
    from .section import (
        ObservedSection as ObservedSection,
        RecordingSection as RecordingSection,
        RunSection as RunSection,
    )
    from .select import (
        SIGNS as SIGNS,
        SPATIAL as SPATIAL,
        Measured as Measured,
        alike as alike,
        by_label as by_label,
        held_loads as held_loads,
        loads_of as loads_of,
        location_verdicts as location_verdicts,
        mean_deviation as mean_deviation,
        outcome_counts as outcome_counts,
        seen_loads as seen_loads,
        settled_loads as settled_loads,
        spatial_spreads as spatial_spreads,
        spread_text as spread_text,
        verdicts_in_words as verdicts_in_words,
    )
    from .station import (
        chart_blocks as chart_blocks,
        counted as counted,
        lines_table as lines_table,
        remedies as remedies,
        station_blocks as station_blocks,
    )
    from .tables import (
        bound_sign as bound_sign,
        capital as capital,
        dashed as dashed,
        duration as duration,
        fixed as fixed,
        limit_text as limit_text,
        margin_text as margin_text,
        named as named,
        number as number,
        parameter_text as parameter_text,
        place_text as place_text,
        plain as plain,
        plural as plural,
        quantity as quantity,
        scaled_unit as scaled_unit,
        text_table as text_table,
        unit_column as unit_column,
        unit_shown as unit_shown,
        value_cell as value_cell,
        with_uncertainty as with_uncertainty,
    )
    from .terminal import terminal_lines as terminal_lines

door(__name__, __file__)
