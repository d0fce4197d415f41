"""Calibration from labelled presses, wherever they were made: tables, registration, learned place."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .electrode_order import find_electrode_order as find_electrode_order
    from .inputs import (
        LabelledPresses as LabelledPresses,
        PressReadings as PressReadings,
        read_press_readings as read_press_readings,
    )
    from .issue import (
        Identity as Identity,
        PressesLearned as PressesLearned,
        issue_from_presses as issue_from_presses,
        learn_presses as learn_presses,
    )
    from .likeness import AnsweringSide as AnsweringSide, compare_sides as compare_sides
    from .number_tables import NumberTable as NumberTable
    from .pairs import DistinctPairs as DistinctPairs, match_readings as match_readings
    from .tables import (
        PressTable as PressTable,
        read_pairs as read_pairs,
        read_presses as read_presses,
        source_file as source_file,
    )
    from .weak_loads import ModelledSheet as ModelledSheet

door(__name__, __file__)
