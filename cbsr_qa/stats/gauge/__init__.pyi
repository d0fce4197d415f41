from .anova import GaugeAnova as GaugeAnova, Source as Source, gauge_anova as gauge_anova
from .crossed_study import (
    BalancedPart as BalancedPart,
    GaugeRange as GaugeRange,
    Study as Study,
    Variance as Variance,
    Variation as Variation,
    gauge_range as gauge_range,
    largest_balanced as largest_balanced,
    missing_runs as missing_runs,
    on as on,
    study as study,
)
from .reference import (
    FEWEST_CHARTED as FEWEST_CHARTED,
    Linearity as Linearity,
    Stability as Stability,
    bias as bias,
    linearity as linearity,
    stability as stability,
    straight_line as straight_line,
)
