"""Statistics of lots and stations: pure functions, checked against certified values."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .control_charts import (
        SUM as SUM,
        Chart as Chart,
        Reference as Reference,
        Standard as Standard,
        cusum as cusum,
        ewma as ewma,
        individuals as individuals,
        means_and_ranges as means_and_ranges,
        moving_range as moving_range,
    )
    from .crossings import Crossing as Crossing, IntArray as IntArray, crossing as crossing
    from .difference import (
        Contrast as Contrast,
        benjamini_hochberg as benjamini_hochberg,
        hedges as hedges,
        holm as holm,
        welch as welch,
    )
    from .golden_lots import (
        Ask as Ask,
        Bound as Bound,
        Distribution as Distribution,
        LotLimits as LotLimits,
        Runs as Runs,
        lot_limits as lot_limits,
        outward as outward,
    )
    from .guard_bands import (
        Risks as Risks,
        Uncertainty as Uncertainty,
        repeatability as repeatability,
        risks as risks,
    )
    from .intervals import (
        FEWEST_VALUES as FEWEST_VALUES,
        Prediction as Prediction,
        count_needed as count_needed,
        one_sided_factor as one_sided_factor,
        predict as predict,
        two_sided_factor as two_sided_factor,
    )
    from .nelson import MOST as MOST, Rule as Rule, d2_d3 as d2_d3
    from .power_analysis import (
        power as power,
        power_of_equivalence as power_of_equivalence,
        sensors_needed as sensors_needed,
        sensors_to_show_alike as sensors_to_show_alike,
    )
    from .process_capability import (
        Capability as Capability,
        Index as Index,
        Yield as Yield,
        capability as capability,
        capability_of_extremes as capability_of_extremes,
        pass_rate as pass_rate,
    )
    from .robust import brunner_munzel as brunner_munzel, shift as shift
    from .samples import (
        LARGEST as LARGEST,
        Estimate as Estimate,
        Interval as Interval,
        quantile as quantile,
        summary as summary,
    )
    from .variance_components import FEWEST_REPEATS as FEWEST_REPEATS, components as components
    from .worst_value import worst_of as worst_of

door(__name__, __file__)
