"""Fits of relaxation, settling, creep and hysteresis to traces of loads."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .agreement import (
        SHAPE_MARGIN as SHAPE_MARGIN,
        TIME_MARGIN as TIME_MARGIN,
        Agreement as Agreement,
        ComparedCurves as ComparedCurves,
        MeasuredRelaxation as MeasuredRelaxation,
        RelaxationAgreement as RelaxationAgreement,
        compare_relaxations as compare_relaxations,
        refuse_comparison as refuse_comparison,
    )
    from .common_relaxation import (
        CommonRelaxation as CommonRelaxation,
        TimedValues as TimedValues,
        common_settling_time as common_settling_time,
        fit_common_relaxation as fit_common_relaxation,
    )
    from .creep_fit import (
        FROM_S as FROM_S,
        SIGNAL as SIGNAL,
        STRESS as STRESS,
        change_between as change_between,
        creep as creep,
        creep_at_constant_stress as creep_at_constant_stress,
        last_cycles as last_cycles,
        last_stresses as last_stresses,
        select_equal_holds as select_equal_holds,
        trace_of as trace_of,
        zero_return as zero_return,
    )
    from .hysteresis_fit import LoopCurve as LoopCurve, hysteresis as hysteresis, loop_curve as loop_curve
    from .quasi_static import QuasiStaticFit as QuasiStaticFit, fit_quasi_static as fit_quasi_static
    from .relaxation import (
        exponentials as exponentials,
        fit_relaxation as fit_relaxation,
        relaxation_curve as relaxation_curve,
    )
    from .relaxation_kernel import learn_kernel as learn_kernel
    from .settling import (
        estimate_restricted_mean as estimate_restricted_mean,
        relaxation_start as relaxation_start,
        settling_time as settling_time,
        window_s as window_s,
    )
    from .steady_state import (
        HoldsSoFar as HoldsSoFar,
        event_rate_per_min as event_rate_per_min,
        interval as interval,
        predict_steady as predict_steady,
    )
    from .superposition import (
        SeparatedSteps as SeparatedSteps,
        StepTrace as StepTrace,
        constants_of as constants_of,
        fit_step as fit_step,
        separate_steps as separate_steps,
        separate_with_constants as separate_with_constants,
        shift_constants as shift_constants,
    )

door(__name__, __file__)
