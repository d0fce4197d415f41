"""Batches, materials, stations, software versions and periods compared."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .comparison import Comparison as Comparison, compare as compare, compare_groups as compare_groups
    from .report import compare_outcome as compare_outcome
    from .terms import (
        Adjustment as Adjustment,
        By as By,
        Period as Period,
        Policy as Policy,
        Quarantine as Quarantine,
        Terms as Terms,
        read_amounts as read_amounts,
        read_groups as read_groups,
    )

door(__name__, __file__)
