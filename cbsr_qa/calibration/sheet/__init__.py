"""Properties of one sheet: response map, baseline, characteristic, data sheet."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .baseline import (
        baseline_conductance as baseline_conductance,
        load_baseline as load_baseline,
        predict_change as predict_change,
    )
    from .characteristic import (
        Characteristic as Characteristic,
        characteristics as characteristics,
        collect_repeated_changes as collect_repeated_changes,
        data_sheet_loads as data_sheet_loads,
        mean_characteristic as mean_characteristic,
        repeatability as repeatability,
        sheet_gauge_factor as sheet_gauge_factor,
        steady_share as steady_share,
        why_no_force as why_no_force,
    )
    from .data_sheet import (
        FEWEST_POINTS as FEWEST_POINTS,
        Estimate as Estimate,
        StraightLine as StraightLine,
        best_straight_line as best_straight_line,
        place_responses as place_responses,
        pool_deviations as pool_deviations,
        ratio_of_sums as ratio_of_sums,
        relative_spread as relative_spread,
        scatter_of_presses as scatter_of_presses,
        slope as slope,
        terminal_line as terminal_line,
    )
    from .response_map import (
        FEWEST as FEWEST,
        LARGEST_ERROR as LARGEST_ERROR,
        ResponseMap as ResponseMap,
        average_response as average_response,
        intercept_column as intercept_column,
        learn_response as learn_response,
        sheet_places as sheet_places,
    )
    from .sheet_pose import AS_PLACED as AS_PLACED, SheetPose as SheetPose, sheet_pose_of as sheet_pose_of

door(__name__, __file__)
