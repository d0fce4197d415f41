"""Limits proposed from a golden lot."""

from typing import TYPE_CHECKING

from cbsr_qa.lazy import door

if TYPE_CHECKING:
    from .golden_lot import LotChoice as LotChoice, read_serials as read_serials
    from .proposals import Terms as Terms
    from .propose import ProposedLimits as ProposedLimits, propose_limits as propose_limits, write_new as write_new
    from .report import limits_outcome as limits_outcome

door(__name__, __file__)
