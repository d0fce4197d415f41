"""Control charts of a station."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .after_run import charts_after as charts_after
    from .charting import (
        STANDS as STANDS,
        UNCOUNTED as UNCOUNTED,
        MetricChart as MetricChart,
        charts_of as charts_of,
        standard_of as standard_of,
    )
    from .charts import Charts as Charts, control_charts as control_charts
    from .report import charts_outcome as charts_outcome
    from .request import ChartsRequest as ChartsRequest, ReferencePeriod as ReferencePeriod

door(__name__, __file__)
