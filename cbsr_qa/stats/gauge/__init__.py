"""Gauge R&R: crossed studies, references, balance."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .anova import GaugeAnova as GaugeAnova, gauge_anova as gauge_anova
    from .balance import largest_balanced as largest_balanced, missing_runs as missing_runs
    from .crossed_study import (
        Components as Components,
        GaugeRange as GaugeRange,
        Study as Study,
        gauge_range as gauge_range,
        on as on,
        study as study,
    )
    from .reference import (
        FEWEST_CHARTED as FEWEST_CHARTED,
        bias as bias,
        linearity as linearity,
        stability as stability,
        straight_line as straight_line,
    )

door(__name__, __file__)
